"""Plan for several arms once all of them rest, and end all their motions when one ends early.

Each arm has a motion of its own, as for any other plan, and waits for its part of the common plan.
The last arm that comes to rest starts the planning. Stopping one arm ends the motions of all. A
handover is a series of such motions, in some of which only one arm does something.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, NamedTuple

from so101_motion.arm.gripper import move_jaw
from so101_motion.common.errors import Interrupted, MotionError

if TYPE_CHECKING:
    from so101_motion.arm.cell_member import CellMember
    from so101_motion.arm.gripper import Gripper
    from so101_motion.arm.motion_handle import Motion, Step
    from so101_motion.planning.cell.team_requests import Handover
    from so101_motion.planning.collision.scene import Attached
    from so101_motion.planning.request import Plan


class TeamPlanning:
    """The planning of one motion of several arms. Any thread may call.

    Args:
        names: The arms.
        plan: Starts to plan for all of them, from where they rest.
        made: Called with the plans before any arm begins.
    """

    def __init__(
        self,
        names: Iterable[str],
        plan: Callable[[], Future[dict[str, Plan]]],
        made: Callable[[Mapping[str, Plan]], None],
    ) -> None:
        self._plan, self._made, self._lock = plan, made, threading.Lock()
        self._parts: dict[str, Future[Plan | None]] = {name: Future() for name in names}
        self._moving = set(self._parts)
        self._planning: Future[dict[str, Plan]] | None = None
        for name, part in self._parts.items():
            part.add_done_callback(partial(self._given_up, name))

    def part(self, name: str) -> Future[Plan | None]:
        """Note that an arm rests; returns its plan, None to stay there.

        Cancelling that gives up the plans of all.
        """
        with self._lock:
            self._moving.discard(name)
            is_last = not self._moving
        if is_last and not any(each.done() for each in self._parts.values()):
            try:
                self._planning = self._plan()
            except Exception as error:
                self._end(error)
            else:
                self._planning.add_done_callback(self._hand_out)
        return self._parts[name]

    def _hand_out(self, done: Future[dict[str, Plan]]) -> None:
        if done.cancelled():
            return
        error = done.exception()
        if error is not None:
            self._end(error)
            return
        plans = done.result()
        try:
            self._made(plans)
        except Exception as refusal:
            self._end(refusal)
            return
        for name, part in self._parts.items():
            with suppress(InvalidStateError):  # one that was given up
                part.set_result(plans.get(name))

    def _given_up(self, name: str, part: Future[Plan | None]) -> None:
        if part.cancelled():
            self._end(Interrupted(f"what ended the motion of {name}"))
            if self._planning is not None:
                self._planning.cancel()

    def _end(self, error: BaseException) -> None:
        for part in self._parts.values():
            with suppress(InvalidStateError):
                part.set_exception(error)


class TeamStep(NamedTuple):
    """One of several common motions.

    Attributes:
        plan: Gives the plan of each arm by its name; called when all of them rest.
        then: The steps that an arm does when it has arrived, by its name.
    """

    plan: Callable[[], Future[dict[str, Plan]]]
    then: Mapping[str, Step | Iterator[Step]]


class TeamSeries:
    """Several common motions, one after the other. Any thread may call.

    Args:
        names: The arms.
        steps: The motions; each is taken when the first arm is done with the one before.
        made: As for ``TeamPlanning``.
    """

    def __init__(
        self,
        names: Iterable[str],
        steps: Iterator[TeamStep],
        made: Callable[[Mapping[str, Plan]], None],
    ) -> None:
        self._names, self._steps, self._made = tuple(names), steps, made
        self._lock = threading.Lock()
        self._newest: tuple[int, TeamStep, TeamPlanning] | None = None

    def of(self, name: str) -> Iterator[Step]:
        """The steps of one arm, for ``Arm.start_series``."""
        for number in count():
            found = self._step(number)
            if found is None:
                return
            step, planning = found
            yield partial(self._wait_for_part, planning, name)
            then = step.then.get(name, ())
            yield from then if isinstance(then, Iterable) else (then,)

    @staticmethod
    def _wait_for_part(planning: TeamPlanning, name: str, motion: Motion) -> Plan | None:
        return motion.wait_for(planning.part(name))

    def _step(self, number: int) -> tuple[TeamStep, TeamPlanning] | None:
        """A step and its planning; no arm is ever more than one step ahead of another."""
        with self._lock:
            if self._newest is None or self._newest[0] < number:
                step = next(self._steps, None)
                if step is None:
                    return None
                planning = TeamPlanning(self._names, step.plan, self._made)
                self._newest = number, step, planning
            return self._newest[1:]


def end_together(motions: Mapping[str, Motion]) -> None:
    """End the motions of several arms as soon as one of them ends early."""

    def end_others(name: str, done: Future[None]) -> None:
        error = done.exception()
        if error is not None:
            why = error.by if isinstance(error, Interrupted) else error
            for key, motion in motions.items():
                if key != name:
                    motion.interrupt(f"what ended the motion of {name}: {why}")

    for name, motion in motions.items():
        motion.future.add_done_callback(partial(end_others, name))


def handover_steps(
    giver: CellMember,
    taker: CellMember,
    plan: Handover,
    check_again: Callable[[Mapping[str, Plan]], Future[dict[str, Plan]]],
) -> Iterator[TeamStep]:
    """The steps of a planned handover.

    The scenes of both change on the way: before the taker goes to the thing, its hand may touch it;
    when its jaw has closed, both arms hold it; when the giver has left, only the taker does.

    Args:
        giver: Who passes the thing on.
        taker: Who gets it.
        plan: The planned handover.
        check_again: As ``Cell.check_again``.
    """

    def refuse_empty(member: CellMember) -> None:
        if not member.gripper.is_holding:
            still = "" if member is giver else f"; {giver.name} still holds it"
            raise MotionError(
                f"{member.name} closed its jaw but holds nothing, so '{plan.thing.name}' cannot"
                f" be passed from {giver.name} to {taker.name}{still}"
            )

    def press(motion: Motion) -> None:
        if giver.gripper.feels and not giver.gripper.is_holding:
            move_jaw(giver.gripper, 0.0, motion)
            refuse_empty(giver)

    def close(motion: Motion) -> None:
        feels = taker.gripper.feels
        closed = 0.0 if feels else _aperture(taker.gripper, plan.q_jaw_closed)
        move_jaw(taker.gripper, closed, motion)
        if feels:
            refuse_empty(taker)
        _hold(taker, replace(plan.taken, passed_to=giver.name))

    def let_go(motion: Motion) -> None:
        move_jaw(giver.gripper, _aperture(giver.gripper, plan.q_jaw_free), motion)
        _hold(giver, plan.thing, no_more=True)

    def be_open(motion: Motion) -> None:
        move_jaw(taker.gripper, _aperture(taker.gripper, plan.q_jaw_open), motion)

    def offer(_: Motion) -> None:
        _hold(giver, replace(plan.thing, passed_to=taker.name))

    stay = partial(check_again, {})
    yield TeamStep(stay, {giver.name: press, taker.name: be_open})
    yield TeamStep(partial(check_again, plan.approach), {giver.name: offer})
    yield TeamStep(stay, {taker.name: lambda _: taker.arm.check_again(plan.take)})
    yield TeamStep(stay, {taker.name: close})
    yield TeamStep(stay, {giver.name: let_go})
    yield TeamStep(stay, {giver.name: lambda _: giver.arm.check_again(plan.leave)})
    yield TeamStep(stay, {taker.name: lambda _: _hold(taker, plan.taken)})


def _aperture(gripper: Gripper, q_jaw: float) -> float:
    share = (q_jaw - gripper.closed) / (gripper.opened - gripper.closed)
    return min(max(share, 0.0), 1.0)


def _hold(member: CellMember, thing: Attached, *, no_more: bool = False) -> None:
    """Have an arm hold a thing from now on, in place of what it held by that name."""
    scene = member.arm.scene
    others = [each for each in scene.attached if each.name != thing.name]
    attached = (*others,) if no_more else (*others, thing)
    member.arm.scene = replace(scene, attached=attached)
