"""The settings of an arm component beyond those of its rig."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import lru_cache

from viam.services.motion import Motion as MotionService

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.files.scene_file import obstacles_from
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import PoseGoal
from so101_motion.viam.component_config import ArmConfig, SensesConfig
from so101_motion.viam.conversion.world_state import MOST_THINGS
from so101_motion.viam.models.configured import Dependencies
from so101_motion.viam.models.dependencies import motion_service


def scene_of(wanted: ArmConfig) -> Scene:
    """The obstacles of an arm's configuration.

    Raises:
        ConfigError: An obstacle is not valid; the message names it.
    """
    if len(wanted.obstacles) > MOST_THINGS:
        given = f"{len(wanted.obstacles)} obstacles"
        raise ConfigError("obstacles", given, f"are more than the {MOST_THINGS} that are read")
    return _scene(wanted.floor_z, json.dumps(wanted.obstacles))


@lru_cache(maxsize=8)
def _scene(floor_z: float | None, obstacles: str) -> Scene:
    """Cached: ``validate_config`` builds it in a thread, and the event loop uses it again."""
    return Scene(floor_z=floor_z, obstacles=obstacles_from(json.loads(obstacles)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmSettings:
    """The settings of an arm component beyond those of its rig.

    Attributes:
        motion: The motion service that plans MoveToPosition; None for our planner.
        visualize_ee_frame: Whether the tool frame is drawn.
        guarded: Whether moves that do not wait and streams keep clear of the arm and of what is
            around it.
        use_urdf: Whether kinematics are served as URDF instead of SVA.
        position_tolerance: Largest position error that counts as arrived [m]; None for the
            planner's.
        approach_tolerance: Largest error of the approach direction [rad]; None for the planner's.
        ignored: Components of the machine that are not planned around.
        senses: The resources of the machine that report the surroundings.
        dependencies: The clients of the resources that the configuration names.
    """

    motion: MotionService | None
    visualize_ee_frame: bool
    guarded: bool
    use_urdf: bool
    position_tolerance: float | None
    approach_tolerance: float | None
    ignored: tuple[str, ...]
    senses: SensesConfig
    dependencies: Dependencies

    @classmethod
    def of(cls, wanted: ArmConfig, dependencies: Dependencies) -> ArmSettings:
        """Read the settings from a configuration.

        Raises:
            ConfigError: The machine has no motion service of that name.
        """
        return cls(
            motion=motion_service(wanted.motion, dependencies),
            visualize_ee_frame=wanted.visualize_ee_frame,
            guarded=wanted.guarded,
            use_urdf=wanted.use_urdf,
            position_tolerance=wanted.position_tolerance,
            approach_tolerance=wanted.approach_tolerance,
            ignored=wanted.ignored,
            senses=wanted.senses,
            dependencies=dependencies,
        )

    def goal(self, T_base_goal: SE3) -> PoseGoal:
        """Add this arm's tolerances to a goal."""
        goal = PoseGoal(T_base_tool=T_base_goal)
        return replace(
            goal,
            position_tolerance=self.position_tolerance or goal.position_tolerance,
            approach_tolerance=self.approach_tolerance or goal.approach_tolerance,
        )
