"""The attributes of every model, by its name without ``devrel:so101:``."""

from __future__ import annotations

from collections.abc import Mapping

from so101_motion.common.attributes import Config
from so101_motion.tasks.teleop.config import TeleopConfig
from so101_motion.viam import component_config

MODELS: Mapping[str, type[Config]] = {
    "arm": component_config.HardwareArmConfig,
    "gripper": component_config.HardwareGripperConfig,
    "simulated": component_config.SimulatedArmConfig,
    "simulated-gripper": component_config.SimulatedGripperConfig,
    "calibration": component_config.CalibrationConfig,
    "motion": component_config.MotionConfig,
    "world-state": component_config.ForAnArmConfig,
    "discovery": component_config.DiscoveryConfig,
    "teleop": TeleopConfig,
}

_ALL = [each for model in MODELS.values() for each in model.rows()]
OURS = {each.name for each in _ALL if each.ours} - {each.name for each in _ALL if not each.ours}
"""The attributes that no model of the published module has."""
