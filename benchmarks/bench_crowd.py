"""Four arms that reach each other: together, one after the other, and following targets.

They stand in a square or on a ring around the place where all of them work, simulated, on a
simulated clock. Three ways to crowd them:

*together*: random goals for all, one motion (``Cell.start_together``);
*each by itself*: every arm that rests for a while is sent to a random goal, whatever the others do;
*following*: every arm follows random targets, all of them in the middle.

Contact is judged by other means than planning and the guard (``solids.py``), at every tick. What is
refused or stopped is counted by its reason. A goal near which another arm rests is refused rightly;
``wrongly refused`` are those whose goal keeps 30 mm from everything that any arm stood or was sent
to. A motion that has not ended after a minute of its time hangs.

    python -m benchmarks.bench_crowd --rounds 40 --ticks 6000
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager

import numpy as np

from benchmarks._common import single_thread, write
from benchmarks.solids import Solids
from so101_motion.arm.cell import Cell
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import So101Error
from so101_motion.common.geometry import SE3, Array
from so101_motion.control.following import Following
from so101_motion.planning.collision.apart import first_meeting
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.course import Course
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated

ARMS = ("north", "east", "south", "west")
CLEAR = 0.03
"""How far goals are from each other that must not be refused [m]."""

LONGEST = 60.0
"""After how much of its own time a motion hangs [s]."""

TRIES = 20
"""So many goals are drawn for an arm that is sent by itself, until one keeps that clear."""

CAPS = MotionLimits.uniform(velocity=np.pi, acceleration=8.0, jerk=150.0)


def around(radius: float, turned: float = 0.0, arms: int = len(ARMS)) -> list[SE3]:
    """Bases on a ring, each looking at its middle."""
    found = []
    for k in range(arms):
        angle = turned + 2.0 * np.pi * k / arms
        place = (radius * np.cos(angle), radius * np.sin(angle), 0.0)
        found.append(SE3.from_rpy((0.0, 0.0, angle + np.pi), place))
    return found


def side_by_side() -> list[SE3]:
    """Bases on the corners of a square, two looking at two."""
    return [
        SE3.from_rpy((0.0, 0.0, 0.0 if x < 0.0 else np.pi), (x, y, 0.0))
        for x, y in ((-0.18, -0.13), (-0.18, 0.13), (0.18, -0.13), (0.18, 0.13))
    ]


LAYOUTS = {"ring": around(0.24), "square": side_by_side()}


class Crowd:
    """Four arms in one cell, and who judges them.

    Args:
        bases: Where they stand.
        seed: Of what is asked of them.
        within: How far from the middle their tools are sent [m]; infinity for anywhere.

    Attributes:
        ticks: How many were looked at.
        touching: In how many of them polytopes of two arms touched.
        solids: Knows how near they came.
    """

    def __init__(self, bases: Sequence[SE3], seed: int, within: float = 0.15) -> None:
        self._within = within
        self.bases, self.random = bases, np.random.default_rng(seed)
        self.solids, self._clock = Solids(*bases), ManualClock()
        self.ticks = self.touching = 0
        self.rigs: list[Rig] = []
        self.cell = Cell()
        self._model = RobotModel.load()
        self._collision, self._bodies = CollisionModel(self._model), bodies_of()

    @contextmanager
    def opened(self) -> Iterator[Crowd]:
        """With the arms there, apart from each other."""
        starts = self.goals([])
        with ExitStack() as stack:
            for name, T, q in zip(ARMS, self.bases, starts, strict=True):
                rig = stack.enter_context(open_simulated(clock=self._clock, q_start=q))
                self.cell.add(name, rig, T)
                self.rigs.append(rig)
            yield self

    def near(self, k: int) -> Array:
        """A configuration of an arm, free by itself, with the tool near the middle."""
        while True:
            q = self.random.uniform(self._model.lower, self._model.upper)
            p = self.bases[k] @ self._model.frame(q).p
            is_near = np.hypot(p[0], p[1]) < self._within and p[2] < max(0.25, self._within)
            if is_near and self._collision.is_free(q):
                return q

    def are_apart(self, k: int, q: Array, j: int, q_other: Array, room: float = CLEAR) -> bool:
        """Whether two arms at rest keep ``room`` [m] apart."""
        one, other = ((self._bodies, Course.resting(each, 0.0)) for each in (q, q_other))
        T = self.bases[k].inverse @ self.bases[j]
        return first_meeting(one, other, T, since=0.0, room=room) is None

    def goals(self, standing: Sequence[Array]) -> list[Array]:
        """A goal for each arm, all of them apart."""
        while True:
            found: list[Array] = []
            for k in range(len(self.bases)):
                for _ in range(200):
                    q = self.near(k)
                    if all(self.are_apart(k, q, j, each) for j, each in enumerate(found)):
                        found.append(q)
                        break
                else:
                    break
            if len(found) == len(self.bases):
                return found

    def tick(self) -> None:
        """Let a control cycle pass, and look."""
        self._clock.advance(0.01)
        q = [np.append(rig.arm.state.q_ref, rig.arm.state.q_jaw_ref) for rig in self.rigs]
        self.ticks += 1
        self.touching += self.solids.touch(*q)
        if self.ticks % 5 == 0:
            self.solids.measure(*q)

    def finish(self, motions: Sequence[Motion]) -> bool:
        """Go on until all are over, which begin together; whether they are in time."""
        moving, begun = 0.0, False
        while not all(each.future.done() for each in motions):
            begun |= all(rig.arm.state.arm_moving for rig in self.rigs)
            if begun:
                moving += 0.01
                self.tick()
            else:
                wait([each.future for each in motions], timeout=0.001)
                self._clock.advance(0.0002)  # they begin at one moment, some milliseconds later
            if moving > LONGEST:
                return False
        return True

    def in_time(self, motion: ThreadPoolExecutor, call: object) -> Following:
        """What ``call`` returns, which waits for time to pass."""
        done = motion.submit(call)  # type: ignore
        while not done.done():
            self._clock.advance(0.01)
        following: Following = done.result()
        return following


def reason(error: BaseException) -> str:
    """Why something ended, without figures and names."""
    words = re.sub("|".join(ARMS), "another", str(error))
    words = re.sub(r"\b(jaw|gripper|wrist|lower arm|upper arm|shoulder|base)\b", "part", words)
    words = re.sub(r"[0-9.]+ mm (into|from)", "near", words)
    return f"{type(error).__name__}: {re.split('[(;]', words)[0].strip()[:80]}"


def together(crowd: Crowd, rounds: int) -> Counter[str]:
    """Random goals for all, in one motion."""
    ends: Counter[str] = Counter()
    for _ in range(rounds):
        wanted = dict(zip(ARMS, map(lambda q: JointGoal(q=q), crowd.goals([])), strict=True))
        motions = crowd.cell.start_together(wanted)
        if not crowd.finish(list(motions.values())):
            ends["hangs"] += 1
            crowd.cell.stop()
            continue
        errors = [each.future.exception() for each in motions.values()]
        own = [error for error in errors if error is not None]
        ends[reason(own[0]) if own else "arrived"] += 1
    return ends


def by_themselves(crowd: Crowd, rounds: int) -> Counter[str]:
    """Each arm that rests is sent to a random goal, while the others do something else."""
    ends: Counter[str] = Counter()
    rests, asked, under_way = [0] * 4, 0, dict[int, tuple[Motion, Array, bool, float]]()
    while asked < 4 * rounds or under_way:
        for k, rig in enumerate(crowd.rigs):
            if k in under_way:
                motion, q, is_clear, lasts = under_way[k]
                if motion.future.done():
                    error = motion.future.exception()
                    ends[reason(error) if error else "arrived"] += 1
                    if error and is_clear and motion.plan is None:
                        ends["wrongly refused"] += 1
                    del under_way[k]
                elif lasts > LONGEST:
                    ends["hangs"] += 1
                    rig.arm.start_stop()
                    del under_way[k]
                else:
                    moved = 0.01 if rig.arm.state.arm_moving else 0.0
                    under_way[k] = motion, q, is_clear, lasts + moved
            elif rests[k] > 0:
                rests[k] -= 1
            elif asked < 4 * rounds:
                asked, rests[k] = asked + 1, int(crowd.random.integers(5, 60))
                for _ in range(TRIES):
                    q = crowd.near(k)
                    if is_clear := _keeps_clear(crowd, k, q, under_way):
                        break
                under_way[k] = rig.arm.move(JointGoal(q=q), wait=False), q, is_clear, 0.0
        pending = [each[0].future for each in under_way.values() if each[0].plan is None]
        if pending:  # planned in the time of this machine, not of theirs
            wait(pending, timeout=0.002)
        crowd.tick()
    return ends


def _keeps_clear(
    crowd: Crowd, k: int, q: Array, under_way: dict[int, tuple[Motion, Array, bool, float]]
) -> bool:
    """Whether a goal is away from where the others stand and were sent."""
    for j, rig in enumerate(crowd.rigs):
        others = [rig.arm.state.q_ref, *([under_way[j][1]] if j in under_way else [])]
        if j != k and not all(crowd.are_apart(k, q, j, each) for each in others):
            return False
    return True


def follow_targets(crowd: Crowd, ticks: int) -> Counter[str]:
    """Every arm follows random targets."""
    ends: Counter[str] = Counter()
    with ThreadPoolExecutor(1) as threads:
        followings = [
            crowd.in_time(
                threads,
                lambda rig=rig: rig.arm.follow(limits=CAPS, stale_after=None, gate=10.0),
            )
            for rig in crowd.rigs
        ]
    left = [0] * len(followings)
    for _ in range(ticks):
        for k, following in enumerate(followings):
            if left[k] == 0:
                try:
                    following.aim(crowd.near(k))
                except So101Error as error:
                    ends[reason(error)] += 1
                left[k] = int(crowd.random.integers(10, 120))
            left[k] -= 1
            ends["held by another [arm ticks]"] += any("'s " in each for each in following.held_by)
        crowd.tick()
    for following in followings:
        following.close()
    return ends


def rows(layout: str, rounds: int, ticks: int, seed: int) -> list[dict[str, object]]:
    """What became of four arms that stand like this."""
    found: list[dict[str, object]] = []
    for name, attack, count in (
        ("together", together, rounds),
        ("each by itself", by_themselves, rounds),
        ("following", follow_targets, ticks),
    ):
        crowd = Crowd(LAYOUTS[layout], seed)
        with crowd.opened():
            ends = attack(crowd, count)
        found.append(
            {
                "what": f"{layout}, {name}",
                "ticks": crowd.ticks,
                "touching": crowd.touching,
                "hulls nearest [mm]": 1e3 * crowd.solids.nearest_hulls,
                "triangles nearest [mm]": 1e3 * crowd.solids.nearest_triangles,
                "ended": dict(ends.most_common()),
            }
        )
        print(found[-1], flush=True)
    return found


def main() -> None:
    """Crowd them in both layouts."""
    single_thread()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--ticks", type=int, default=6000)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    write(
        "bench_crowd",
        [row for name in LAYOUTS for row in rows(name, asked.rounds, asked.ticks, asked.seed)],
    )


if __name__ == "__main__":
    main()
