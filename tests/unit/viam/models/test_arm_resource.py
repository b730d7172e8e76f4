import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.viam.component_config import SimulatedArmConfig
from so101_motion.viam.conversion.world_state import MOST_THINGS


def config(count):
    boxes = [
        {"name": f"box {i}", "box_mm": [5, 5, 5], "position_mm": [500, 0, i]} for i in range(count)
    ]
    return SimulatedArmConfig.from_attributes({"obstacles": boxes})


def test_what_was_checked_once_is_not_built_again():
    assert len(config(2).scene.obstacles) == 2
    assert config(2).scene is config(2).scene
    assert config(2).scene is not config(1).scene


def test_too_many_obstacles_are_refused():
    with pytest.raises(ConfigError, match=f"{MOST_THINGS + 1} obstacles.*more than"):
        _ = config(MOST_THINGS + 1).scene
