"""``move_together`` of the motion service: several arms move to goals in one motion.

``{"move_together": {"left": {"joints_deg": [0, -40, 40, 60, 0]}, "right": {"pose": {"x": 200,
"z": 150, "o_z": 1}}}}``: joint angles [deg], or a pose of the tool in that arm's base frame [mm,
deg] as for MoveToPosition. The arms share a cell (``viam/surroundings/machine_cell.py``);
those that are not named hold still.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import TYPE_CHECKING

from viam.proto.common import Pose

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.attributes import Attributes, suggest
from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS
from so101_motion.planning.goals import Goal, JointGoal
from so101_motion.viam.conversion import convert

if TYPE_CHECKING:
    from so101_motion.viam.models.arm_resource import ArmResource

_POSE = ("x", "y", "z", "o_x", "o_y", "o_z", "theta")


async def move_together(
    asked: object,
    arms: Mapping[str, ArmResource],
    seen_through: Callable[[ArmResource, Motion], Awaitable[None]],
) -> None:
    """Move several arms to goals in one motion; returns when all have arrived.

    Args:
        asked: Their goals by name, as in the request.
        arms: The arms of this process.
        seen_through: Waits for the motion of an arm; ends it with the call.

    Raises:
        ConfigError: A goal is not valid, or the arms do not know each other.
        So101Error: What one of the motions raises.
    """
    goals = _goals(asked, arms)
    for name in goals:
        await arms[name].ready()
    first = arms[next(iter(goals))]
    scenes = {first.short_name: await first.surroundings.around(first.rig.arm.scene)}
    place = first.rig.arm.place
    if place is None or not set(goals) <= place.cell.places.keys():
        raise ConfigError(
            "move_together",
            sorted(goals),
            "are arms that do not know each other; each needs a frame in the machine's"
            ' configuration, and time must pass for all alike ("simulate_time")',
        )
    for name in place.cell.places.keys() - scenes.keys():
        arm = arms[name]
        scenes[name] = await arm.surroundings.around(arm.rig.arm.scene)
    motions = place.cell.start_together(goals, scenes=scenes)
    waiting = [asyncio.ensure_future(seen_through(arms[each], m)) for each, m in motions.items()]
    try:
        await asyncio.gather(*waiting)
    finally:
        for each in waiting:
            each.cancel()
        await asyncio.gather(*waiting, return_exceptions=True)


def _goals(asked: object, arms: Mapping[str, ArmResource]) -> dict[str, Goal]:
    if not isinstance(asked, Mapping) or not asked:
        raise ConfigError("move_together", asked, 'must be goals by arm: {"left": {...}, ...}')
    goals = {}
    for name, value in asked.items():
        if name not in arms:
            raise ConfigError("move_together", name, suggest(str(name), arms))
        if not isinstance(value, Mapping):
            raise ConfigError(name, value, 'must be {"joints_deg": [...]} or {"pose": {...}}')
        given = Attributes(value, ("joints_deg", "pose"), kind="key")
        goals[name] = _goal(given, value.get("pose"), arms[name])
    return goals


def _goal(given: Attributes, wanted: object, arm: ArmResource) -> Goal:
    if given.given("joints_deg") == given.given("pose"):
        raise ConfigError("goal", "...", "must have one of joints_deg and pose")
    if given.given("joints_deg"):
        most = len(ARM_JOINTS)
        joints = given.numbers("joints_deg", count=most, lower=-360.0, upper=360.0)
        q = convert.from_joint_values(joints, what="joints_deg")
        arm.rig.arm.model.check_limits(q)
        arm.rig.arm.range.check(q)
        return JointGoal(q=q)
    if not isinstance(wanted, Mapping):
        raise ConfigError("pose", wanted, 'must be an object such as {"x": 200, "z": 150}')
    pose = Attributes(wanted, _POSE, kind="key of a pose")
    numbers = {key: pose.number(key, float(key == "o_z"), lower=-1e6, upper=1e6) for key in _POSE}
    return arm.settings.goal(convert.from_pose(Pose(**numbers)))
