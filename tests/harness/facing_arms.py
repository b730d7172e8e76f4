"""Two arms that face each other, 350 mm apart, and configurations that bring them together."""

from concurrent.futures import ThreadPoolExecutor, wait

import coal
import numpy as np

from so101_motion.arm.cell import Cell
from so101_motion.common.clock import ManualClock
from so101_motion.common.geometry import SE3, rot_z
from so101_motion.planning.collision.apart import GUARDED, first_meeting, nearness
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.course import Course
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.simulated_rig import open_simulated

T_LEFT_RIGHT = SE3(rot_z(np.pi), np.array([0.35, 0.0, 0.0]))
HIGHEST = {"speed": np.pi, "acceleration": 8.0}
FAST = MotionLimits.uniform(velocity=3.0, acceleration=8.0, jerk=150.0)
ASIDE = np.radians([60.0, -30.0, 30.0, 30.0, 0.0])


def distance(bodies, q_left, q_right, T=T_LEFT_RIGHT):
    """coal's distance between two arms at configurations (6,) [m], without that of their bases."""
    data = bodies.model.createData(), bodies.model.createData()
    left = bodies.placed(q_left, SE3.identity(), data[0])
    right = bodies.placed(q_right, T, data[1])
    return min(
        coal.distance(a.shape, left[i], b.shape, right[j], coal.DistanceRequest(),
                      coal.DistanceResult())
        for i, a in enumerate(bodies.objects)
        for j, b in enumerate(bodies.objects)
        if a.joint or b.joint
    )  # fmt: skip


class FacingArms:
    """Two simulated arms in a cell, on a clock that a test moves.

    Args:
        stack: Closes them.
        clock: That clock.
        q_starts: Where they begin.
        caps: Their speed and acceleration; by default the highest.
        left: What else the left one is opened with.
    """

    def __init__(self, stack, *, clock=None, q_starts=(ASIDE, ASIDE), caps=HIGHEST, **left):
        self.clock, self.cell = clock or ManualClock(), Cell()
        self.rigs, self.arms = [], {}
        for (name, T, own), q in zip(
            (("left", SE3.identity(), left), ("right", T_LEFT_RIGHT, {})), q_starts, strict=True
        ):
            rig = stack.enter_context(open_simulated(clock=self.clock, q_start=q, **caps, **own))
            self.cell.add(name, rig, T)
            self.rigs.append(rig)
            self.arms[name] = rig.arm

    def pass_time(self, futures, until=lambda: False, look=lambda: None):
        """Let time pass until ``until()`` or all futures are done; ``look()`` after each step."""
        moving = 0  # cycles; how many pass while a plan is made depends on how busy the machine is
        while moving < 4000:
            if until() or all(future.done() for future in futures):
                return
            if any(arm.state.arm_moving for arm in self.arms.values()):
                moving += 1
            else:
                wait(futures, timeout=0.001)  # threads' turn
            self.clock.advance(0.01)
            look()
        raise AssertionError("it goes on and on")


class Facing:
    """Draws configurations that are free by themselves, with the tool where the other reaches."""

    def __init__(self, seed):
        self.random, self.model = np.random.default_rng(seed), RobotModel.load()
        self.collision, self.bodies = CollisionModel(self.model), bodies_of()

    def near(self):
        while True:
            q = self.random.uniform(self.model.lower, self.model.upper)
            x, y, z = self.model.frame(q).p
            if 0.1 < x < 0.28 and abs(y) < 0.12 and z < 0.25 and self.collision.is_free(q):
                return q

    def drawn(self, fits, count=2):
        """So many of them that fit each other."""
        while not fits(*(qs := [self.near() for _ in range(count)])):
            pass
        return qs

    def are_apart(self, q_left, q_right, room=0.024):
        left, right = (Course.resting(q, 0.0) for q in (q_left, q_right))
        pair = (self.bodies, left), (self.bodies, right)
        return first_meeting(*pair, T_LEFT_RIGHT, since=0.0, room=room) is None

    def task_of_starts(self):
        """Two starts and two goals, at each of which both may stand."""
        drawn = self.drawn(
            lambda a, b, *goals: self.are_apart(a, b, 0.03) and self.are_apart(*goals, 0.03), 4
        )
        return drawn[:2], drawn[2:]

    def task(self):
        """Two starts and two goals; everybody may stand there while the other does."""
        apart = self.are_apart
        drawn = self.drawn(lambda a, b, c, d: apart(a, b) and apart(c, d) and apart(c, b), 4)
        return drawn[:2], drawn[2:]


def in_time(clock, call, each=lambda: None, patience=0.0):
    """Call what waits for an arm while time passes; it has ``patience`` [s] before each period."""
    with ThreadPoolExecutor(1) as threads:
        done = threads.submit(call)
        while not wait([done], timeout=patience).done:
            clock.advance(0.01)
            each()
    return done.result()


class Pair(FacingArms):
    """The same two arms; every advance looks whether they are apart."""

    def __init__(self, clock, facing, q_left, q_right, stack):
        super().__init__(stack, clock=clock, q_starts=(q_left, q_right), caps={})
        self.facing = facing
        self.left, self.right = self.arms.values()

    def advance(self, seconds=0.01, room=0.7 * GUARDED):
        self.clock.advance(seconds)
        assert self.are_apart(room)

    def are_apart(self, room):
        return self.facing.are_apart(self.left.state.q_ref, self.right.state.q_ref, room)

    def gap(self):
        """How near they are, up to 30 mm [m]."""
        left, right = (
            Course.resting(each.state.q_ref, each.state.q_jaw_ref)
            for each in (self.left, self.right)
        )
        pair = (self.facing.bodies, left), (self.facing.bodies, right)
        found = nearness(*pair, T_LEFT_RIGHT, at=0.0, room=0.03)
        return 0.03 if found is None else found

    def arrive(self, *motions, **options):
        """Finish motions that must not fail."""
        self.finish(*motions, **options)
        for each in motions:
            each.result()

    def finish(self, *motions, room=0.7 * GUARDED):
        def look():
            assert self.are_apart(room)

        self.pass_time([each.future for each in motions], look=look)


def crossing_task(facing):
    """A task in which the straight motions of both at once would meet."""
    while True:
        starts, goals = facing.task()
        middles = [0.5 * (a + b) for a, b in zip(starts, goals, strict=True)]
        if not facing.are_apart(*middles, room=0.005):
            return starts, goals
