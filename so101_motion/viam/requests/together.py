"""Answer the motion service's commands for several arms of one cell.

``move_together`` takes joint angles [deg] or poses of the tool in an arm's base frame [mm, deg] by
arm; others hold still. ``holds`` sets the objects in an arm's hand, in its tool frame. ``handover``
passes such an object to another arm. The requests are in docs/cell.md.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from viam.proto.common import Pose

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.attributes import Attributes, suggest
from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.state import ARM_JOINTS
from so101_motion.files.scene_file import attached_from, attached_to
from so101_motion.planning.goals import Goal, JointGoal
from so101_motion.viam.conversion import convert

if TYPE_CHECKING:
    from so101_motion.arm.cell import Cell
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.viam.models.arm_resource import ArmResource

SeenThrough = Callable[["ArmResource", Motion], Awaitable[None]]

_POSE = ("x", "y", "z", "o_x", "o_y", "o_z", "theta")


async def move_together(
    asked: object, arms: Mapping[str, ArmResource], seen_through: SeenThrough
) -> None:
    """Move several arms to goals in one motion; returns when all have arrived."""
    goals = _goals(asked, arms)
    cell, scenes = await _cell_of("move_together", list(goals), arms)
    await _all_seen_through(cell.start_together(goals, scenes=scenes), arms, seen_through)


async def hand_over(
    asked: object, arms: Mapping[str, ArmResource], seen_through: SeenThrough
) -> Any:
    """Pass an object from one hand to another; returns it as an entry of ``holds``."""
    if not isinstance(asked, Mapping):
        raise ConfigError("handover", asked, 'must be {"from": ..., "to": ..., "object": ...}')
    given = Attributes(asked, ("from", "to", "object"), kind="key of a handover")
    giver, taker = (_known(given.text(key, ""), arms, "handover") for key in ("from", "to"))
    cell, scenes = await _cell_of("handover", [giver, taker], arms)
    plan = await asyncio.to_thread(
        cell.plan_handover, giver, taker, given.text("object", ""), scenes=scenes
    )
    await _all_seen_through(cell.start_handover(plan), arms, seen_through)
    return attached_to([plan.taken])[0]


async def set_held(asked: object, arms: Mapping[str, ArmResource]) -> None:
    """Set the objects in the arms' hands, all or none."""
    if not isinstance(asked, Mapping):
        raise ConfigError("holds", asked, 'must be objects by arm: {"left": [...]}')
    scenes = {}
    for name, entries in asked.items():
        arm = arms[_known(str(name), arms, "holds")].rig.arm
        with _about(str(name)):
            held = await asyncio.to_thread(attached_from, entries, folder=None)
        scenes[name] = replace(arm.scene, attached=held)
    for name, scene in scenes.items():
        arms[name].rig.arm.scene = scene


def _known(name: str, arms: Mapping[str, ArmResource], key: str) -> str:
    if name not in arms:
        raise ConfigError(key, name, suggest(name, arms))
    return name


async def _cell_of(
    key: str, names: Sequence[str], arms: Mapping[str, ArmResource]
) -> tuple[Cell, dict[str, Scene]]:
    """The cell that arms share, and the surroundings of each of its arms."""
    for name in names:
        await arms[name].ready()
    first = arms[names[0]]
    scenes = {first.short_name: await first.surroundings.around(first.rig.arm.scene)}
    cell = first.cell.cell_of(first.short_name)
    if cell is None or not set(names) <= cell.members.keys():
        raise ConfigError(
            key,
            sorted(names),
            "do not share a cell; give each arm a frame in the machine's configuration, and the"
            ' same "simulate_time" to all',
        )
    for name in cell.members.keys() - scenes.keys():
        arm = arms[name]
        scenes[name] = await arm.surroundings.around(arm.rig.arm.scene)
    return cell, scenes


async def _all_seen_through(
    motions: Mapping[str, Motion], arms: Mapping[str, ArmResource], seen_through: SeenThrough
) -> None:
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
        _known(str(name), arms, "move_together")
        with _about(str(name)):
            goals[name] = _goal(value, arms[name])
    return goals


@contextmanager
def _about(arm: str) -> Iterator[None]:
    try:
        yield
    except So101Error as error:
        raise error.about(arm) from None


def _goal(value: object, arm: ArmResource) -> Goal:
    if not isinstance(value, Mapping):
        raise ConfigError("goal", value, 'must be {"joints_deg": [...]} or {"pose": {...}}')
    given = Attributes(value, ("joints_deg", "pose"), kind="key")
    wanted = value.get("pose")
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
    return arm.goal(convert.from_pose(Pose(**numbers)))
