"""The attributes of every model, by its name without ``devrel:so101:``."""

from __future__ import annotations

from collections.abc import Mapping

from so101_motion.common.attributes import Config
from so101_motion.tasks.teleop.config import TeleopConfig
from so101_motion.viam.component_config import (
    CalibrationConfig,
    DiscoveryConfig,
    ForAnArmConfig,
    HardwareArmConfig,
    HardwareGripperConfig,
    MotionConfig,
    SimulatedArmConfig,
    SimulatedGripperConfig,
)

MODELS: Mapping[str, type[Config]] = {
    "arm": HardwareArmConfig,
    "gripper": HardwareGripperConfig,
    "simulated": SimulatedArmConfig,
    "simulated-gripper": SimulatedGripperConfig,
    "calibration": CalibrationConfig,
    "motion": MotionConfig,
    "world-state": ForAnArmConfig,
    "discovery": DiscoveryConfig,
    "teleop": TeleopConfig,
}

_ALL = [each for model in MODELS.values() for each in model.rows()]
OURS = {each.name for each in _ALL if each.ours} - {each.name for each in _ALL if not each.ours}
"""The attributes that no model of the published module has."""
