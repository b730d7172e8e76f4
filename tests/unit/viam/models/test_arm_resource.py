import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.viam.component_config import SimulatedArmConfig
from so101_motion.viam.conversion.world_state import MOST_THINGS
from so101_motion.viam.models.arm_resource import scene_of


def config(count):
    boxes = [
        {"name": f"box {i}", "box_mm": [5, 5, 5], "position_mm": [500, 0, i]} for i in range(count)
    ]
    return SimulatedArmConfig.from_attributes({"obstacles": boxes})


def test_what_was_checked_once_is_not_built_again():
    assert len(scene_of(config(2)).obstacles) == 2
    assert scene_of(config(2)) is scene_of(config(2))
    assert scene_of(config(2)) is not scene_of(config(1))


def test_too_many_obstacles_are_refused():
    with pytest.raises(ConfigError, match=f"{MOST_THINGS + 1} obstacles.*more than"):
        scene_of(config(MOST_THINGS + 1))
