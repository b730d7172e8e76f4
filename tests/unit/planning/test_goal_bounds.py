"""Goals too far away to be accepted."""

import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.planning.goals import ApproachGoal, LineGoal, PoseGoal


@pytest.mark.parametrize("goal", [PoseGoal, LineGoal, ApproachGoal])
@pytest.mark.parametrize("far", [1e305, 1e308, 2_000.0])
def test_a_goal_out_of_this_world_is_refused(goal, far):
    with pytest.raises(ConfigError, match="of the base"):
        goal(T_base_tool=SE3.from_translation([0.2, -far, 0.1]))


def test_a_line_that_would_take_long_to_look_along_is_refused():
    with pytest.raises(ConfigError, match="within 5 m"):
        LineGoal(T_base_tool=SE3.from_translation([30.0, 0.0, 0.1]))
