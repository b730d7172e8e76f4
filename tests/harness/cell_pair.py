"""Two simulated arms of one cell that face each other, on a clock that a test moves."""

from concurrent.futures import ThreadPoolExecutor

from harness.facing_arms import T_LEFT_RIGHT
from so101_motion.arm.cell import Cell
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.apart import GUARDED, nearness
from so101_motion.planning.collision.course import Course
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.simulated_rig import open_simulated

FAST = MotionLimits.uniform(velocity=3.0, acceleration=8.0, jerk=150.0)


def in_time(clock, call):
    """Call what waits for an arm while time passes."""
    with ThreadPoolExecutor(1) as threads:
        done = threads.submit(call)
        while not done.done():
            clock.advance(0.01)
    return done.result()


class Pair:
    """Two simulated arms that face each other; every advance looks whether they are apart."""

    def __init__(self, clock, facing, q_left, q_right, stack):
        self.clock, self.facing = clock, facing
        self.rigs = [
            stack.enter_context(open_simulated(clock=clock, q_start=q)) for q in (q_left, q_right)
        ]
        self.left, self.right = (rig.arm for rig in self.rigs)
        self.cell = Cell()
        self.cell.add("left", self.rigs[0], SE3.identity())
        self.cell.add("right", self.rigs[1], T_LEFT_RIGHT)

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

    def finish(self, *motions, room=0.7 * GUARDED):
        moving = 0  # cycles; how many pass while a plan is made depends on how busy the machine is
        while moving < 3000:
            if all(each.future.done() for each in motions):
                return
            self.advance(room=room)
            moving += self.left.is_moving or self.right.is_moving
        raise AssertionError("it goes on and on")


def crossing_task(facing):
    """A task in which the straight motions of both at once would meet."""
    while True:
        starts, goals = facing.task()
        middles = [0.5 * (a + b) for a, b in zip(starts, goals, strict=True)]
        if not facing.are_apart(*middles, room=0.005):
            return starts, goals
