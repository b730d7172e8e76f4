"""The arm of a running machine: sets the machine's caps, plans around what the machine has."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from so101_motion.arm.arm import Arm
from so101_motion.arm.joint_caps import JointCaps
from so101_motion.common.errors import MachineRefused, So101Error
from so101_motion.files.scene_file import arms_from, attached_from, obstacles_from
from so101_motion.planning.collision.scene import Scene
from so101_motion.viam.conversion.world_state import UniqueNames, taken_in
from so101_motion.viam.requests.commands import in_deg


class MachineArm(Arm):
    """The arm of a machine. ``set_speed`` and ``set_acceleration`` set the machine's as well."""

    tell: Callable[[Mapping[str, Any]], object] | None = None
    """Sends a request to the machine's arm; None if that arm has no such caps."""

    surroundings: Callable[[], Mapping[str, Any]] = staticmethod(dict)
    """What the machine has around the arm besides ``scene``, as it said last: ``obstacles`` and
    ``attached`` as in a scene file, its other ``arms``, or why that is not known (``unknown``)."""

    def set_speed(self, speed: float) -> None:
        """See ``Arm.set_speed``; if the machine refuses, nothing changes."""
        before = self._caps
        super().set_speed(speed)
        self._pass_on({"set_speed": in_deg(speed)}, before)

    def set_acceleration(self, acceleration: float) -> None:
        """See ``Arm.set_acceleration``; if the machine refuses, nothing changes."""
        before = self._caps
        super().set_acceleration(acceleration)
        self._pass_on({"set_acceleration": in_deg(acceleration)}, before)

    def _with_surroundings(self, scene: Scene) -> Scene:
        told = self.surroundings()
        if "unknown" in told:
            raise MachineRefused("planning", "UNAVAILABLE", str(told["unknown"]))
        names = UniqueNames(taken_in(scene))
        obstacles = obstacles_from(told.get("obstacles", []), folder=None)
        attached = attached_from(told.get("attached", []), folder=None)
        return replace(
            scene,
            arms=(*scene.arms, *arms_from(told.get("arms", []))),
            obstacles=(
                *scene.obstacles,
                *(replace(each, name=names.new(each.name)) for each in obstacles),
            ),
            attached=(
                *scene.attached,
                *(replace(each, name=names.new(each.name)) for each in attached),
            ),
        )

    def _pass_on(self, request: Mapping[str, Any], before: JointCaps) -> None:
        if self.tell is not None:
            try:
                self.tell(request)
            except So101Error:
                self._caps = before
                raise
