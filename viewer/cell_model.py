"""State and commands of the Move tab of several arms that share a space, without viser.

Each arm has a ``ViewModel`` with its target and its part of the plan. A ``CellModel`` has what they
share: one plan, one position on its timeline, one motion. As soon as one arm drops its part, the
plan is dropped for all. One thread owns a ``CellModel``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from so101_motion.arm.cell import Cell
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import Interrupted
from so101_motion.planning.collision.apart import Meeting, clearance_over_time
from so101_motion.planning.request import Plan

from .page import texts
from .page.plan_view import Playback
from .page.screen_state import Sentence
from .view_model import ViewModel

LOOKS = 80
"""Instants at which the clearance between two arms is computed; chosen: takes about 10 ms."""


class Between(NamedTuple):
    """The clearance between two arms over the time of their plans: their closest bodies at each."""

    first: str
    second: str
    closest: tuple[Meeting, ...]

    @property
    def least(self) -> Meeting:
        return min(self.closest, key=lambda each: each.distance)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommonPlan:
    """A plan for all arms, by their names, with the clearance of every two arms."""

    plans: Mapping[str, Plan]
    clearances: tuple[Between, ...]
    name: str

    @property
    def duration(self) -> float:
        return max(each.duration for each in self.plans.values())


class CellModel:
    """State and commands of the Move tab of several arms; ``now`` is the time [s]."""

    def __init__(
        self,
        cell: Cell,
        arms: Mapping[str, ViewModel],
        *,
        submit: Callable[[Callable[[], CommonPlan]], Future[CommonPlan]],
        now: Callable[[], float],
        welcome: str,
    ) -> None:
        self._cell, self.arms, self._submit, self._now = cell, dict(arms), submit, now
        self._sentence = Sentence(welcome)
        self.plan_view: CommonPlan | None = None
        self._planning: Future[CommonPlan] | None = None
        self._motions: dict[str, Motion] = {}
        self._playback = Playback()
        self._count, self._drops = 0, [0]

    # Commands

    def plan(self) -> None:
        if self.can_plan:
            goals = {name: arm.target.goal for name, arm in self.arms.items()}
            self._count += 1
            called = f"Plan {self._count}"

            def made() -> CommonPlan:
                plans = self._cell.plan_together(goals)
                return CommonPlan(plans=plans, clearances=self._clearances(plans), name=called)

            self._drops = self._all_drops()
            self._planning = self._submit(made)
            self._sentence = texts.PLANNING

    def execute(self) -> None:
        if self.plan_view is not None and self.can_execute:
            self._motions = self._cell.move(self.plan_view.plans, wait=False)
            for name, motion in self._motions.items():
                self.arms[name].follow(motion)
            self._playback.seek(self.plan_view.duration)
            self._sentence = texts.MOVING

    def preview(self, t: float) -> None:
        """Show the ghosts ``t`` seconds into the plan."""
        if self.plan_is_current:
            self._playback.seek(t)
            self._place_ghosts()

    def play(self, rate: float) -> None:
        if self.plan_is_current:
            self._playback.play(rate)

    def set_speed(self, speed: float) -> None:
        """Set the speed cap of the next plan [rad/s]."""
        for arm in self.arms.values():
            arm.set_speed(speed)

    def set_acceleration(self, acceleration: float) -> None:
        """Set the acceleration cap of the next plan [rad/s^2]."""
        for arm in self.arms.values():
            arm.set_acceleration(acceleration)

    def show_sweep(self, shown: bool) -> None:
        for arm in self.arms.values():
            arm.show_sweep(shown)

    def report(self, error: BaseException) -> None:
        self._sentence = texts.ended(error)

    def tell(self, sentence: Sentence) -> None:
        self._sentence = sentence

    # Updates

    def refresh(self) -> bool:
        """Take in changes since the last call; return whether there is anything new to show."""
        news = [arm.refresh() for arm in self.arms.values()]
        news += [self._collect_plan(), self._collect_motions(), self._notice_dropped_parts()]
        if self._playback.advance(self._now()):
            self._place_ghosts()
            news.append(True)
        return any(news)

    # What is shown

    @property
    def sentence(self) -> Sentence:
        for name, each in self.arms.items():
            has_problem = each.target.problem is not None and not self._motions
            if has_problem or texts.blocked(each.state) is not None:
                return texts.named(name, each.sentence)
        return self._sentence

    @property
    def plan_is_current(self) -> bool:
        return all(arm.plan_is_current for arm in self.arms.values())

    @property
    def can_plan(self) -> bool:
        return (
            self._planning is None
            and not self._motions
            and all(
                each.target.problem is None and texts.blocked(each.state) is None
                for each in self.arms.values()
            )
            and any(each.can_plan for each in self.arms.values())
        )

    @property
    def can_execute(self) -> bool:
        return not self._motions and all(each.can_execute for each in self.arms.values())

    @property
    def preview_time(self) -> float:
        """How far into the plan the ghosts stand [s]."""
        return self._playback.t

    @property
    def progress(self) -> float:
        return max(each.progress for each in self.arms.values())

    @property
    def caps(self) -> tuple[float, float]:
        """Speed [rad/s] and acceleration cap [rad/s^2] of the next plan, of the slowest arm."""
        speeds, accelerations = zip(*(each.caps for each in self.arms.values()), strict=True)
        return min(speeds), min(accelerations)

    @property
    def sweeps(self) -> bool:
        return all(each.sweeps for each in self.arms.values())

    # Helpers

    def _collect_plan(self) -> bool:
        if self._planning is None or not self._planning.done():
            return False
        future, self._planning = self._planning, None
        if self._drops != self._all_drops():
            self._sentence = texts.CHANGED_MEANWHILE
            return True
        error = future.exception()
        if error is not None:
            self._sentence = texts.ended(error)
            return True
        self.plan_view = future.result()
        for name, arm in self.arms.items():
            arm.take_plan(self.plan_view.plans[name], self.plan_view.name)
        self._playback.load(self.plan_view.duration)
        self._sentence = texts.ALL_PLANNED
        return True

    def _collect_motions(self) -> bool:
        motions = self._motions
        if not motions or not all(each.future.done() for each in motions.values()):
            return False
        self._motions = {}
        errors = {name: each.future.exception() for name, each in motions.items()}
        failed = {name: error for name, error in errors.items() if error is not None}
        first = next((each for each in failed.values() if not isinstance(each, Interrupted)), None)
        if first is not None:
            self._sentence = texts.ended(first)
        elif failed:
            self._sentence = texts.ALL_STOPPED
        else:
            off = max(arm.distance_to_goal() for arm in self.arms.values())
            self._sentence = texts.arrived(off)
        return True

    def _notice_dropped_parts(self) -> bool:
        current = [arm.plan_is_current for arm in self.arms.values()]
        if self._motions or not any(current) or all(current):
            return False
        for name, arm in self.arms.items():
            if not arm.plan_is_current:
                self._sentence = texts.named(name, arm.sentence)
        for arm in self.arms.values():
            if arm.plan_is_current:
                arm.drop_plan(texts.PRESS_PLAN)
        return True

    def _all_drops(self) -> list[int]:
        return [arm.drops for arm in self.arms.values()]

    def _place_ghosts(self) -> None:
        for arm in self.arms.values():
            arm.preview(self._playback.t)

    def _clearances(self, plans: Mapping[str, Plan]) -> tuple[Between, ...]:
        members = self._cell.members
        times = np.linspace(0.0, max(each.duration for each in plans.values()), LOOKS)
        courses = {name: members[name].along(plan.trajectory, 0.0) for name, plan in plans.items()}
        found = []
        for a, b in combinations(plans, 2):
            T = members[a].T_cell_base.inverse @ members[b].T_cell_base
            pair = (members[a].bodies, courses[a]), (members[b].bodies, courses[b])
            found.append(Between(a, b, tuple(clearance_over_time(*pair, T, times))))
        return tuple(found)
