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

from so101_motion.arm.arm import Arm
from so101_motion.arm.gripper import Gripper, move_jaw
from so101_motion.arm.motion_handle import Motion, Step
from so101_motion.arm.motion_queue import wait_here
from so101_motion.common.errors import MotionError, So101Error
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.state import JointState
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.request_queue import running_future
from so101_motion.planning.collision.scene import Attached, Scene
from so101_motion.planning.goals import GoalMetric, LineGoal
from so101_motion.planning.picking.grasps import Wishes
from so101_motion.planning.picking.pick_plan import PickPlan, PickRequest, Place
from so101_motion.planning.request import Plan, Search

TRIES = 3  # grasps that are tried, if the jaws do not hold the item; chosen

LOST_FOR = 10
"""After how many readings without it a grip is lost; chosen, 0.1 s: a jaw may swing for a moment"""

OTHER = to_rad(8.0)
"""How far from the expected angle a jaw may have closed on the item [rad]. Chosen: 11 mm between
the tips, more than the gap and the errors of scenes, and less than an item beside it."""

HELD_STAGES = ("lift", "carry", "lower")

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
    """

    def __init__(
        self, arm: Arm, gripper: Gripper, around: Callable[[], Scene] | None = None
    ) -> None:
        self.arm, self.gripper = arm, gripper
        self.around = around or (lambda: arm.scene)
        self.upright: dict[str, Array] = {}  # how held items stood before, by name

    def plan(self, name: str, place: Place | None = None, wishes: Wishes | None = None) -> PickPlan:
        """Plan to pick an item, to place it, or both; moves nothing.

        Args:
            name: An item of the scene, to pick it; or what the gripper holds, to place it.
            place: Where to put it; None to hold it.
            wishes: What you say about grasps.

        Raises:
            ConfigError: There is no such item.
            PlanningError: It cannot be gripped, reached, carried or put there; the error says why.
        """
        arm, search = self.arm, Search(scene=self.around())
        task = PickRequest(
            request=arm.request(LineGoal(T_base_tool=arm.T_base_tool), search=search),
            item=name,
            place=place,
            wishes=wishes or Wishes(),
            R_base_item=self.upright.get(name),
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
        return PickRun(self, name, place, wishes or Wishes(), tries, planned, tell)

    @property
    def is_held(self) -> bool:
        """Whether the gripper holds something, as far as it can be measured."""
        return self.gripper.is_holding or not self.gripper.feels


class PickRun:
    """A picking, a placing, or both, under way.

    Attributes:
        future: Completes when it is done, or raises what ended it; what is held stays held.
        motion: The motion of the arm that it is.
        stage: What is being done, a key of ``DOING``.
        plan: What is carried out; None while it is planned.
    """

    def __init__(
        self,
        picker: Picker,
        name: str,
        place: Place | None,
        wishes: Wishes,
        tries: int,
        planned: PickPlan | None,
        tell: Tell,
    ) -> None:
        self.name, self.stage, self.plan = name, "plan", planned
        self.future: Future[None] = running_future()
        self._picker, self._arm, self._gripper = picker, picker.arm, picker.gripper
        self._place, self._wishes, self._tries, self._tell = place, wishes, tries, tell
        self._held = self._lost = False
        self._misses = 0
        self._scene = self._arm.scene
        self.motion = self._arm.start_series(self._steps())
        self._end_watch = self._gripper.listen(self._look)
        self.motion.future.add_done_callback(self._ended)

    def result(self) -> None:
        """Wait until it is done; raises what ended it earlier."""
        with suppress(So101Error):
            self.motion.result()
        self.future.result()

    def stop(self) -> None:
        """End it early; the arm slows to rest, and what is held stays held. Returns at once."""
        self.motion.interrupt("stop")

    # The arm's thread

    def _steps(self) -> Iterator[Step]:
        held = any(each.name == self.name for each in self._arm.scene.attached)
        if not held:
            self.plan = yield from self._picking()
        else:
            self.plan = self.plan or self._picker.plan(self.name, self._place)
            if not self._picker.is_held:
                raise MotionError(f"the gripper does not hold '{self.name}', so it is not placed")
        self._held = True
        plan = self.plan
        for stage in HELD_STAGES:
            if stage in plan.plans:
                scene = plan.scenes[stage]
                self._have(next(each for each in scene.attached if each.name == self.name))
                self._begin(stage)
                yield plan.plans[stage]
                if stage == "lift":
                    self._refuse_lost()
                    self._tell(f"'{self.name}' is held")
        last = "end" if self._place is None else "carry"
        held_in = plan.scenes[last].attached
        if self._place is None:
            self._have(next(each for each in held_in if each.name == self.name))
            return
        assert plan.q_jaw_free is not None
        self._refuse_lost()
        self._begin("let go")
        self._held = False
        put = next(each for each in plan.scenes["end"].obstacles if each.name == self.name)
        self._swap(replace(self._without(), obstacles=(*self._without().obstacles, put)))
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
                    self.plan = self._picker.plan(self.name, self._place, wishes)
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
        return self._arm.plan(goal, search=Search(scene=plan.scenes["reach"]))

    def _begin(self, stage: str) -> None:
        if self._arm.scene is not self._scene:
            raise MotionError(
                f"the scene has changed since '{self.name}' was planned for; the arm holds before"
                f" {DOING[stage].format(self.name)}. Ask for it again"
            )
        self.stage = stage

    def _have(self, held: Attached) -> None:
        self._swap(replace(self._without(), attached=(*self._without().attached, held)))

    def _without(self) -> Scene:
        scene = self._arm.scene
        return replace(
            scene,
            obstacles=tuple(each for each in scene.obstacles if each.name != self.name),
            attached=tuple(each for each in scene.attached if each.name != self.name),
        )

    def _swap(self, scene: Scene) -> None:
        self._arm.scene = self._scene = scene

    def _refuse_lost(self) -> None:
        if not self._picker.is_held:
            self._lost = True
            raise MotionError("the grip was lost")

    # The I/O thread

    def _look(self, _: JointState) -> None:
        if not self._held or self._lost:
            return
        self._misses = 0 if self._picker.is_held else self._misses + 1
        if self._misses >= LOST_FOR:
            self._lost = True
            self.motion.interrupt("a lost grip")

    def _ended(self, done: Future[None]) -> None:
        self._end_watch()
        error, name = done.exception(), self.name
        doing = DOING[self.stage].format(name)
        if error is None:
            self.future.set_result(None)
        elif self._lost:
            self._swap(self._without())
            self.future.set_exception(
                MotionError(
                    f"the grip on '{name}' was lost while {doing}; the arm has stopped and"
                    f" '{name}' is no more in its scene: look where it lies"
                )
            )
        elif isinstance(error, So101Error):
            still = f", '{name}' is still held" if self._held and self._picker.is_held else ""
            self.future.set_exception(error.about(f"{doing}{still}"))
        else:
            self.future.set_exception(error)
