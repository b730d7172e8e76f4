"""List the models of this module; each is imported when a configuration first asks for it.

What a machine does not have costs neither time at the start nor memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from viam.components.arm import Arm
from viam.components.gripper import Gripper
from viam.components.sensor import Sensor
from viam.proto.app.robot import ComponentConfig
from viam.resource.base import ResourceBase
from viam.resource.registry import Registry, ResourceCreatorRegistration
from viam.resource.types import API, Model
from viam.services.discovery import Discovery
from viam.services.generic import Generic
from viam.services.motion import Motion
from viam.services.worldstatestore import WorldStateStore

from so101_motion.common.realtime import import_quietly
from so101_motion.viam.models.configured import Configured, Dependencies


@dataclass(frozen=True, slots=True)
class RegisteredModel:
    """A model that is imported when it is first used."""

    api: API
    name: str  # without ``devrel:so101:``
    file: str  # the file in this folder that has it, without ending
    class_name: str
    plans: bool = False  # it has an arm, and so needs the planning process

    @property
    def model(self) -> Model:
        return Model.from_string(f"devrel:so101:{self.name}")

    def load(self) -> type[Configured]:
        """Import it; takes half a second the first time."""
        module = import_quietly(f"{__package__}.{self.file}")
        found: type[Configured] = getattr(module, self.class_name)
        return found

    def validate_config(self, config: ComponentConfig) -> tuple[Sequence[str], Sequence[str]]:
        return self.load().validate_config(config)

    def new(self, config: ComponentConfig, dependencies: Dependencies) -> ResourceBase:
        made = self.load().new(config, dependencies)
        assert isinstance(made, ResourceBase)
        return made


MODELS = (
    RegisteredModel(Arm.API, "arm", "hardware_arm", "HardwareArm", plans=True),
    RegisteredModel(Gripper.API, "gripper", "hardware_gripper", "HardwareGripper"),
    RegisteredModel(Arm.API, "simulated", "simulated", "SimulatedArm", plans=True),
    RegisteredModel(Gripper.API, "simulated-gripper", "simulated_gripper", "SimulatedGripper"),
    RegisteredModel(Sensor.API, "calibration", "calibration", "So101Calibration"),
    RegisteredModel(Discovery.API, "discovery", "discovery", "So101Discovery"),
    RegisteredModel(Motion.API, "motion", "motion_service", "So101Motion"),
    RegisteredModel(Generic.API, "teleop", "teleop", "So101Teleop"),
    RegisteredModel(WorldStateStore.API, "world-state", "world_state_store", "So101WorldState"),
)
"""Every model of this module."""


def register() -> None:
    for each in MODELS:
        Registry.register_resource_creator(
            each.api, each.model, ResourceCreatorRegistration(each.new, each.validate_config)
        )


def registered(api: str, model: str) -> RegisteredModel | None:
    return next((m for m in MODELS if (str(m.api), str(m.model)) == (api, model)), None)
