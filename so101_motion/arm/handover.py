"""Carry out a planned handover: the steps of each arm, and when it waits for the other.

Each arm has one motion from the beginning to the end, so stopping one arm ends it for all. The
scenes of the arms change on the way: before the taker goes to the thing, its hand may touch it;
when its jaw has closed, both arms hold it; when the giver has left, only the taker does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from so101_motion.arm.gripper import move_jaw
from so101_motion.common.errors import MotionError

if TYPE_CHECKING:
    from so101_motion.arm.cell_member import CellMember
    from so101_motion.arm.gripper import Gripper
    from so101_motion.arm.motion_handle import Motion, Step
    from so101_motion.planning.cell.team_requests import Handover
    from so101_motion.planning.collision.scene import Attached
    from so101_motion.planning.request import Plan


class HandoverRun:
    """The steps of the arms of a cell in a handover.

    Args:
        members: The arms.
        plan: The planned handover.
    """

    def __init__(self, members: Mapping[str, CellMember], plan: Handover) -> None:
        self._plan, self._giver, self._taker = plan, members[plan.giver], members[plan.taker]
        self._offered, self._taken, self._left = Future[None](), Future[None](), Future[None]()

    def steps(
        self, member: CellMember, approach: Callable[[str], Future[Plan | None]]
    ) -> Iterator[Step]:
        """The steps of one arm, for ``Arm.start_series``.

        Args:
            member: The arm.
            approach: Called when an arm is ready; completes with its first plan when all are.
        """
        if member is self._giver:
            yield self._hold
        elif member is self._taker:
            yield partial(_open, member.gripper, self._plan.q_jaw_open)
        yield lambda motion: motion.wait_for(approach(member.name))
        if member is self._giver:
            yield from self._giving()
        elif member is self._taker:
            yield from self._taking()

    def _giving(self) -> Iterator[Step]:
        plan, member = self._plan, self._giver
        _take_up(member, replace(plan.thing, passed_to=plan.taker))
        self._offered.set_result(None)
        yield lambda motion: motion.wait_for(_shared(self._taken))
        yield partial(_open, member.gripper, plan.q_jaw_free)
        _put_down(member, plan.thing)
        yield plan.leave
        _take_up(self._taker, plan.taken)
        self._left.set_result(None)

    def _taking(self) -> Iterator[Step]:
        plan, member = self._plan, self._taker
        yield lambda motion: motion.wait_for(_shared(self._offered))
        yield plan.take
        yield self._close
        _take_up(member, replace(plan.taken, passed_to=plan.giver))
        self._taken.set_result(None)
        yield lambda motion: motion.wait_for(_shared(self._left))

    def _hold(self, motion: Motion) -> None:
        """Have the giver press on the thing, if it does not yet.

        Raises:
            MotionError: There is nothing in its hand.
        """
        gripper = self._giver.gripper
        if not gripper.feels or gripper.is_holding:
            return
        move_jaw(gripper, 0.0, motion)
        self._refuse_empty(self._giver)

    def _close(self, motion: Motion) -> None:
        """Close the taker's jaw on the thing.

        Raises:
            MotionError: There was nothing.
        """
        gripper = self._taker.gripper
        if not gripper.feels:
            move_jaw(gripper, _aperture(gripper, self._plan.q_jaw_closed), motion)
            return
        move_jaw(gripper, 0.0, motion)
        self._refuse_empty(self._taker)

    def _refuse_empty(self, member: CellMember) -> None:
        if not member.gripper.is_holding:
            plan = self._plan
            still = "" if member is self._giver else f"; {plan.giver} still holds it"
            raise MotionError(
                f"{member.name} closed its jaw but holds nothing, so '{plan.thing.name}' cannot"
                f" be passed from {plan.giver} to {plan.taker}{still}"
            )


def _open(gripper: Gripper, q_jaw: float, motion: Motion) -> None:
    move_jaw(gripper, _aperture(gripper, q_jaw), motion)


def _aperture(gripper: Gripper, q_jaw: float) -> float:
    share = (q_jaw - gripper.closed) / (gripper.opened - gripper.closed)
    return min(max(share, 0.0), 1.0)


def _take_up(member: CellMember, thing: Attached) -> None:
    """Have an arm hold a thing from now on, in place of what it held by that name."""
    scene = member.arm.scene
    others = tuple(each for each in scene.attached if each.name != thing.name)
    member.arm.scene = replace(scene, attached=(*others, thing))


def _put_down(member: CellMember, thing: Attached) -> None:
    scene = member.arm.scene
    others = tuple(each for each in scene.attached if each.name != thing.name)
    member.arm.scene = replace(scene, attached=others)


def _shared(awaited: Future[None]) -> Future[None]:
    """A future that completes with ``awaited`` and can be cancelled without cancelling it."""
    own: Future[None] = Future()

    def pass_on(_: Future[None]) -> None:
        if own.set_running_or_notify_cancel():
            own.set_result(None)

    awaited.add_done_callback(pass_on)
    return own
