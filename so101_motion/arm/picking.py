"""Pick items and place them: carry out what ``planning/picking`` has planned.

A run is one motion of the arm, so a stop and a newer motion end it at any instant. All stages are
planned before the first one moves. Whether the jaws hold the item is measured: by the gripper's own
detection, and by how far the jaw has closed. If they do not, the jaw opens, the arm goes straight
back, and the next grasp is planned and tried. A grip that is lost while the item is lifted, carried
or lowered stops the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from functools import partial
from threading import Thread
from typing import TYPE_CHECKING

from so101_motion.arm.arm import Arm
from so101_motion.arm.gripper import Gripper, move_jaw
from so101_motion.arm.motion_handle import Motion, Step
from so101_motion.arm.motion_queue import wait_here
from so101_motion.common.attributes import checked_kind, checked_number
from so101_motion.common.errors import ConfigError, MotionError, So101Error
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.state import JointState
from so101_motion.common.units import in_mm, to_deg, to_rad
from so101_motion.control.request_queue import running_future
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import GoalMetric, LineGoal
from so101_motion.planning.picking.grasps import Wishes
from so101_motion.planning.picking.pick_plan import HELD_STAGES, PickPlan, PickRequest, Place
from so101_motion.planning.request import Plan, Search

if TYPE_CHECKING:
    from so101_motion.arm.cell_member import Stand

TRIES = 3  # grasps that are tried, if the jaws do not hold the item; chosen

LOST_FOR = 10
"""After how many readings without it a grip is lost; chosen, 0.1 s: a jaw may swing for a moment"""

LET_GO = to_rad(3.0)
"""A jaw that moves so far while nothing is carried out lets go of what it holds [rad]; chosen."""

OTHER = to_rad(8.0)
"""How far from the expected angle a jaw may have closed on the item [rad]. Chosen: 11 mm between
the tips, more than the gap and the errors of scenes, and less than an item beside it."""

DOING = {
    "plan": "planning",
    "open": "opening the jaw",
    "approach": "moving to '{}'",
    "reach": "straight in to '{}'",
    "close": "closing on '{}'",
    "lift": "lifting '{}'",
    "carry": "carrying '{}'",
    "lower": "setting down '{}'",
    "let go": "letting go of '{}'",
    "leave": "straight out",
    "back": "back from '{}'",
}
"""What a stage does, with the item's name."""

Tell = Callable[[str], None]


class Picker:
    """Picks items with an arm and places them. Any thread may call.

    Args:
        arm: The arm; its scene has the items, and changes when one is held or put down.
        gripper: Its gripper.
        around: The scene to plan in; the arm's own if not given. Called on the arm's thread.

    Attributes:
        holding: What brought the item that is held, until another lets it go; it watches the grip.
        upright: How held items stood before they were picked, shape (3, 3), by their names.
        seen: Where an item is that was lost, in the base frame; None if nobody knows.
    """

    seen: Callable[[str], SE3 | None] = staticmethod(lambda _: None)

    def __init__(
        self, arm: Arm, gripper: Gripper, around: Callable[[], Scene] | None = None
    ) -> None:
        self.arm, self.gripper = arm, gripper
        self.around = around or (lambda: arm.scene)
        self.holding: PickRun | None = None
        self.upright: dict[str, Array] = {}

    def plan(
        self,
        name: str,
        place: Place | None = None,
        wishes: Wishes | None = None,
        *,
        stand: Stand | None = None,
        scene: Scene | None = None,
        upright: Array | None = None,
        share: float = 1.0,
    ) -> PickPlan:
        """Plan to pick an item, to place it, or both; moves nothing.

        Args:
            name: An item of the scene, to pick it; or what the gripper holds, to place it.
            place: Where to put it; None to hold it.
            wishes: What you say about grasps.
            stand: Where the arm will be; where it is if not given.
            scene: In what scene; as it is now if not given.
            upright: How a held item stood before, shape (3, 3).
            share: Of the arm's caps that motions may have.

        Raises:
            ConfigError: There is no such item.
            PlanningError: It cannot be gripped, reached, carried or put there; the error says why.
        """
        arm = self.arm
        q, q_jaw = stand or (None, None)
        task = PickRequest(
            request=arm.request(
                LineGoal(T_base_tool=arm.T_base_tool),
                limits=arm.limits.eased(share),
                search=Search(scene=scene or self.around()),
                q_start=q,
                q_jaw=q_jaw,
            ),
            item=name,
            place=place,
            wishes=wishes or Wishes(),
            R_base_item=self.upright.get(name) if upright is None else upright,
        )
        return wait_here(arm.start_task(task))

    def start(
        self,
        name: str,
        place: Place | None = None,
        wishes: Wishes | None = None,
        *,
        tries: int = TRIES,
        planned: PickPlan | None = None,
        tell: Tell = lambda _: None,
    ) -> PickRun:
        """Pick an item, place it, or both; supersedes what is under way. Never waits.

        Args:
            name: As for ``plan``, like the next two.
            place: Where to put it.
            wishes: What you say about grasps.
            tries: How many grasps are tried.
            planned: What ``plan`` has returned, if the arm still is where it was.
            tell: Called with each sentence about what happens; must be brief.
        """
        checked_kind("name", name, str, "the name of an item, as the scene calls it")
        checked_kind("wishes", wishes, Wishes | None, f"{Wishes.__module__}.Wishes(...)")
        checked_number("tries", tries, lower=1)
        run = PickRun(self, name, place, wishes or Wishes(), tries, planned, tell)
        run.watch(self.arm.start_series(run.steps()))
        run.motion.future.add_done_callback(run.ended)
        return run

    @property
    def is_held(self) -> bool:
        """Whether the gripper holds something, as far as it can be measured."""
        return self.gripper.is_holding or not self.gripper.feels


class PickRun:
    """A picking, a placing, or both, under way, or a part of a longer motion.

    Attributes:
        future: Completes when it is done, or raises what ended it; what is held stays held.
        motion: The motion of the arm that it is.
        stage: What is being done, a key of ``DOING``.
        is_lost: Whether the grip was lost.
        share: Of the arm's caps that motions may have which are planned later.
        plan: What is carried out; None while it is planned.
    """

    def __init__(
        self,
        picker: Picker,
        name: str,
        place: Place | None,
        wishes: Wishes = Wishes(),  # noqa: B008  # immutable
        tries: int = TRIES,
        planned: PickPlan | None = None,
        tell: Tell = lambda _: None,
    ) -> None:
        self.name, self.stage, self.plan = name, "plan", planned
        self.future: Future[None] = running_future()
        self._picker, self._arm, self._gripper = picker, picker.arm, picker.gripper
        self._place, self._wishes, self._tries, self._tell = place, wishes, tries, tell
        self.is_lost, self.share = False, 1.0
        self._misses = 0
        self._scene = self._arm.scene

    def __repr__(self) -> str:
        over, doing = self.future.done(), DOING[self.stage].format(self.name)
        now = self.future.exception() or "done" if over else doing
        return f"<PickRun of '{self.name}': {now}>"

    def watch(self, motion: Motion) -> None:
        """Watch the grip while the motion lasts of which ``steps`` are a part, and the grip."""
        self.motion = motion
        self._end_watch = self._gripper.listen(self._look)

    def result(self) -> None:
        """Wait until it is done; raises what ended it earlier."""
        with suppress(So101Error):
            self.motion.result()
        self.future.result()

    def stop(self) -> None:
        """End it early; the arm slows to rest, and what is held stays held. Returns at once."""
        self.motion.interrupt("stop")

    def told(self, error: So101Error) -> So101Error:
        """What ended it, in its own words."""
        if isinstance(error, ConfigError):
            return error  # what was asked for is wrong, whatever is being done
        doing = DOING[self.stage].format(self.name)
        if self.is_lost:
            at = self._lose()
            return MotionError(
                f"the grip on '{self.name}' was lost while {doing}; the arm has stopped, {at}"
            )
        still = self._picker.holding is self and self._picker.is_held
        return error.about(f"{doing}, '{self.name}' is still held" if still else doing)

    # The arm's thread

    def steps(self) -> Iterator[Step]:
        """What the arm does; all of it is planned when the first step is taken."""
        held = any(each.name == self.name for each in self._arm.scene.attached)
        if not held:
            self.plan = yield from self._picking()
        else:
            self.plan = self.plan or self._picker.plan(self.name, self._place, share=self.share)
            if not self._picker.is_held:
                raise MotionError(f"the gripper does not hold '{self.name}', so it is not placed")
        self._q_held, self._picker.holding = self._gripper.q_jaw, self
        plan = self.plan
        for stage in HELD_STAGES:
            if stage in plan.plans:
                self._swap(plan.applied(self._arm.scene, stage))
                self._begin(stage)
                yield plan.plans[stage]
                if stage == "lift":
                    self._refuse_lost()
                    self._tell(f"'{self.name}' is held")
        if self._place is None:
            self._swap(plan.applied(self._arm.scene, "end"))
            self.stage = "carry"  # until it is put down
            return
        assert plan.q_jaw_free is not None
        self._refuse_lost()
        self._begin("let go")
        self._picker.holding = None
        self._swap(plan.applied(self._arm.scene, "end"))
        self._picker.upright.pop(self.name, None)
        yield partial(self._jaw, plan.q_jaw_free)
        self._begin("leave")
        yield plan.plans["leave"]
        self._tell(f"'{self.name}' is put down")

    def _picking(self) -> Generator[Step, None, PickPlan]:
        """Try grasps until one holds; returns the plan of that one."""
        wishes, why = self._wishes, ""
        for number in range(1, self._tries + 1):
            if number > 1 or self.plan is None:
                self.stage = "plan"
                try:
                    self.plan = self._picker.plan(self.name, self._place, wishes, share=self.share)
                except So101Error as error:
                    raise error if number == 1 else error.about(why) from None
            plan = self.plan
            grasp, q_open = plan.grasp, plan.q_jaw_open
            assert grasp is not None
            assert q_open is not None
            self._begin("open")
            yield partial(self._jaw, q_open)
            for stage in ("approach", "reach"):
                self._begin(stage)
                yield plan.plans[stage]
            self._begin("close")
            yield partial(self._jaw, None if self._gripper.feels else plan.q_jaw_closed)
            why = self._not_held(plan)
            if not why:
                self._picker.upright[self.name] = plan.R_base_item
                return plan
            self._tell(f"{why}; the jaw opens")
            self._begin("back")
            yield partial(self._jaw, q_open)
            yield partial(self._straight_back, plan)
            wishes = replace(wishes, never=(*wishes.never, grasp.T_item_tip))
        raise MotionError(
            f"'{self.name}' was not held in {self._tries} tries: {why}; look whether it is where"
            " the scene has it"
        )

    def _not_held(self, plan: PickPlan) -> str:
        """Why the jaws do not hold the item, as measured; empty if they do."""
        gripper = self._gripper
        if not gripper.feels:
            self._tell("a simulated jaw feels nothing: that it holds is assumed")
            return ""
        if not gripper.is_holding:
            return f"the jaws closed on nothing where '{self.name}' should be"
        off = gripper.q_jaw - plan.q_jaw_closed
        if abs(off) > OTHER:
            what = "wider" if off > 0.0 else "narrower"
            return (
                f"what the jaws hold is {what} than '{self.name}': the jaw stands"
                f" {abs(to_deg(off)):.0f} deg from where that would stop it"
            )
        return ""

    def _jaw(self, q_jaw: float | None, motion: Motion) -> None:
        """Move the jaw to an angle [rad]; None to close until it holds something."""
        gripper, aperture = self._gripper, 0.0
        if q_jaw is not None:
            aperture = (q_jaw - gripper.closed) / (gripper.opened - gripper.closed)
        move_jaw(gripper, min(max(aperture, 0.0), 1.0), motion)

    def _straight_back(self, plan: PickPlan, _: Motion) -> Plan:
        into = plan.plans["reach"].tool_path
        back = self._arm.T_base_tool
        goal = LineGoal(
            T_base_tool=SE3(back.R, back.p + into[0] - into[-1]),
            metric=GoalMetric.POSITION_AND_APPROACH,
        )
        limits = self._arm.limits.eased(self.share)
        return self._arm.plan(goal, limits=limits, search=Search(scene=plan.scenes["reach"]))

    def _begin(self, stage: str) -> None:
        scene, planned = self._arm.scene, self._scene
        if scene is not planned:
            left = tuple(each for each in planned.obstacles if each in scene.obstacles)
            if scene == replace(planned, obstacles=left):  # another arm has taken something
                self._scene = planned = scene
        if scene is not planned:
            raise MotionError(
                f"the scene has changed since '{self.name}' was planned for; the arm holds before"
                f" {DOING[stage].format(self.name)}. Ask for it again"
            )
        self.stage = stage

    def _lose(self) -> str:
        """Have the item where it is seen, or no more in the scene; says so."""
        scene, name = self._arm.scene, self.name
        held = next((each for each in scene.attached if each.name == name), None)
        if held is None:
            return "look where it lies"
        T_last, T = self._arm.T_base_tool @ held.T_tool_object, self._picker.seen(name)
        if T is None:
            rest = tuple(each for each in scene.attached if each is not held)
            self._swap(replace(scene, attached=rest))
            where = f"was last at {in_mm(T_last.p)}"
            return f"and '{name}', no more in its scene, {where}: look where it lies"
        self._swap(scene.putting(name, T))
        return f"and '{name}' lies at {in_mm(T.p)}"

    def _swap(self, scene: Scene) -> None:
        self._arm.scene = self._scene = scene

    def _refuse_lost(self) -> None:
        if not self._picker.is_held:
            self.is_lost = True
            raise MotionError("the grip was lost")

    # The I/O thread

    def _look(self, _: JointState) -> None:
        is_over = self.motion.future.done()
        if self._picker.holding is not self or self.is_lost:
            if is_over:
                self._end_watch()
            return
        if is_over:  # servos that are held anew press no more
            is_held = abs(self._gripper.q_jaw - self._q_held) < LET_GO
        else:
            is_held = self._picker.is_held
        self._misses = 0 if is_held else self._misses + 1
        if self._misses < LOST_FOR:
            return
        self.is_lost = True
        if is_over:
            Thread(target=lambda: self._tell(f"the jaw was opened, {self._lose()}")).start()
        else:
            self.motion.interrupt("a lost grip")

    def ended(self, done: Future[None]) -> None:
        """Complete ``future`` as the motion has ended."""
        error = done.exception()
        if error is None:
            self.future.set_result(None)
        else:
            self.future.set_exception(self.told(error) if isinstance(error, So101Error) else error)
