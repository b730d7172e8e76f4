"""Two emulated arms, driven by the real rigs on one clock, and a leader moved as a hand would."""

from concurrent.futures import wait
from contextlib import closing

import numpy as np
from referee.command import CommandCaps
from referee.official import WIDEST

from harness.emulated_rig import HardwareBench
from harness.facing_arms import in_time
from so101_motion.common.clock import ManualClock
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.drivers.emulator.hand import Hand, Waypoint
from so101_motion.tasks.teleop import LocalArm, LocalFollower, LocalLeader, Teleop
from so101_motion.tasks.teleop.pilot import Phase

JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)
PERIOD = 0.01
"""Of the setpoints [s]."""

LOWEST_DEG = np.array([-60.0, -45.0, -35.0, -55.0, -80.0, 5.0])
HIGHEST_DEG = np.array([60.0, 15.0, 50.0, 60.0, 80.0, 70.0])
"""Where the hand leads the joints. At worst, for a moment, the gripper is in the table: that counts
only for a follower with a guard."""


FOLLOWING = (
    *(CommandCaps(180.0, 500.0, np.degrees(1e3)),) * 5,
    CommandCaps(90.0, np.degrees(10.0), np.degrees(600.0), braking=1376.0),
)
"""What joints may do that follow a leader, or a program's targets."""


def human_motion(seconds, seed, *, dt=0.01, tremor_deg=0.08, fastest=120.0):
    """Joint angles of somebody who leads an arm, shape (n, 6), [deg]: a row each ``dt``.

    Reaches of minimum jerk (Flash and Hogan 1985), up to ``fastest`` [deg/s] and 150 to 350
    deg/s^2, with pauses between them, every joint at its own times, and the trembling of a hand at
    6 to 10 Hz.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, dt)
    angles = np.zeros((len(t), 6))
    for i in range(6):
        now, here = 0.3, 0.0 if i < 5 else 20.0
        q = np.full(len(t), here)
        while now < seconds:
            goal = rng.uniform(LOWEST_DEG[i], HIGHEST_DEG[i])
            far = abs(goal - here)
            speed, hard = rng.uniform(30.0, fastest), 5.77 * far / rng.uniform(150, 350)
            begin = now + rng.choice([0.0, rng.uniform(0.0, 0.6)])
            duration = max(0.35, 1.875 * far / speed, hard**0.5)
            u = np.clip((t - begin) / duration, 0.0, 1.0)
            q += np.where(t >= begin, (goal - here) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2), 0.0)
            here, now = goal, begin + duration
        tremble = np.sin(2.0 * np.pi * rng.uniform(6.0, 10.0) * t + rng.uniform(0.0, 6.0))
        angles[:, i] = q + tremor_deg * np.minimum(t, 1.0) * tremble
    return angles


def best_shift(leader, follower, dt, longest=0.15):
    """By how much the follower is behind [s], and what remains then, root mean square.

    One shift for all joints, the one that leaves least; to a fraction of ``dt`` by a parabola.
    Nothing else is taken out, no offset either.
    """
    shift, errors = _best(leader, follower, dt, longest, np.square)
    return shift, float(min(errors) ** 0.5)


def shifts(leader, follower, dt, *, window, longest=0.15, least=10.0):
    """By how much each joint is behind in each stretch of time [s], all in one list.

    ``leader`` and ``follower`` have a row each ``dt`` [s], shape (n, m), [deg]. Stretches are
    ``window`` long and overlap; shifts up to ``longest`` are looked for; a joint that moves less
    than ``least`` [deg] in a stretch does not count. The shift is the one that leaves the least
    variance, so a joint that rests a little off is not taken for one that is late.
    """
    found, length, edge = [], round(window / dt), round(longest / dt)
    for begin in range(edge, len(leader) - length - edge, max(1, length // 8)):
        part = slice(begin - edge, begin + length + edge)
        for i in range(leader.shape[1]):
            if np.ptp(leader[begin : begin + length, i]) >= least:
                pair = leader[part, i : i + 1], follower[part, i : i + 1]
                found.append(_best(*pair, dt, longest, lambda e: np.square(e - e.mean()))[0])
    return np.array(found)


def _best(leader, follower, dt, longest, cost):
    edge = round(longest / dt)
    middle = leader[edge:-edge]
    lags = range(-edge, edge + 1)
    costs = [
        float(np.mean(cost(follower[edge + lag : edge + lag + len(middle)] - middle)))
        for lag in lags
    ]
    k = int(np.argmin(costs))
    part = 0.0
    if 0 < k < len(costs) - 1:
        before, least, after = costs[k - 1 : k + 2]
        part = 0.5 * (before - after) / (before - 2.0 * least + after)
    return (lags[k] + part) * dt, costs


class Arm(HardwareBench):
    """An emulated arm and its rig."""

    def __init__(self, folder, name, clock, reply_timeout, **options):
        super().__init__(folder, name=name, clock=clock, reply_timeout=reply_timeout, **options)
        self.rig = self.open()

    def _caps(self):
        return WIDEST

    def _command_caps(self):
        return FOLLOWING

    @property
    def q_deg(self):
        """True angles of the six joints [deg], with the zero of the calibration."""
        true = super().q_deg
        for i, joint in enumerate(JOINTS):
            servo, setup = self.world.servo(joint), self.rig.servos.setups[joint]
            off = setup.map.zero_ticks - servo.joint.zero_ticks
            true[i] -= servo.joint.direction * off * 360.0 / 4096.0
        return true

    def lead(self, angles_deg, dt=0.01, joints=JOINTS):
        """A hand takes the joints and leads them along rows of angles [deg], as the world counts.

        It begins softly: the first row is reached after 0.3 s.
        """
        script = []
        for joint, column in zip(joints, np.asarray(angles_deg, dtype=float).T, strict=True):
            script.append(Waypoint(t=0.0, joint=joint))
            script += [
                Waypoint(t=0.3 + k * dt, joint=joint, q=float(q))
                for k, q in enumerate(np.radians(column))
            ]
        self.emulator.advance()
        self.world.hand = Hand(script, self.world.t)

    def lead_to(self, degrees, seconds):
        """A hand leads all joints from where they are to ``degrees``, softly."""
        self.emulator.advance()
        here = np.degrees(self.world.q)
        u = np.linspace(0.0, 1.0, max(2, round(seconds / 0.02)))[:, None]
        way = here + (np.asarray(degrees) - here) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        self.lead(way, dt=0.02)


class TeleopBench:
    """A leader and a follower on one clock.

    Attributes:
        goals: What was written to the follower: rows of time and six angles [rad].
    """

    def __init__(
        self, folder, *, reply_timeout=2.0, phase=0.004, leader=None, follower=None, clock=None
    ):
        self.clock = clock or ManualClock()
        self.leader = Arm(folder, "leader", self.clock, reply_timeout, **(leader or {}))
        self.clock.advance(phase)  # the two threads do not tick at the same instant
        self.follower = Arm(folder, "follower", self.clock, reply_timeout, **(follower or {}))
        self.clock.advance(1.0)  # their weight is taken up
        self.goals = []
        self.teleop = None
        self._end = self.follower.rig.executor.listen(self._note)

    def _note(self, state):
        if not self.goals or state.t > self.goals[-1][0]:
            self.goals.append((state.t, *state.q_ref, state.q_jaw_ref))

    def start(self, *, guarded=False, recorder=None, **options):
        """Begin; the leader is held by a hand where it stands."""
        self.leader.lead_to(np.degrees(self.leader.world.q), 0.1)
        leading, following = (
            LocalArm(station=arm.rig, jaw=arm.rig) for arm in (self.leader, self.follower)
        )
        self.teleop = Teleop(
            LocalLeader(leading), LocalFollower(following, guarded=guarded), self.clock, **options
        )
        self.run(lambda: self.teleop.start(recorder), patience=0.1)  # in no time if it needs none
        return self.teleop

    def advance(self, seconds):
        """Let time pass, a period at a time, with a moment for the session's own thread."""
        for _ in range(round(seconds / 0.01)):
            self.clock.advance(0.01)
            self.settle()

    def settle(self):
        if self.teleop is not None and self.teleop.job is not None:
            wait([self.teleop.job], timeout=0.01)

    def until(self, condition, at_most=20.0):
        """Let time pass until ``condition()``; how long that took [s]."""
        begin = self.clock.now()
        while not condition():
            assert self.clock.now() - begin < at_most, "it never came"
            self.advance(0.01)
        return self.clock.now() - begin

    def run(self, call, patience=0.002):
        """The outcome of a blocking ``call`` while time passes; ``patience`` [s] before it does."""
        return in_time(self.clock, call, patience=patience)

    def close(self):
        self._end()
        if self.teleop is not None:
            self.run(self.teleop.close)
        self.leader.close()
        self.follower.close()


def teleop_bench(folder, **options):
    return closing(TeleopBench(folder, **options))


def setpoints(bench, since=0.0):
    """Times, angles and speeds of the follower's arm joints [s], [deg], [deg/s]."""
    rows = np.array([row for row in bench.goals if row[0] >= since - 1e-9])
    t, q = rows[:, 0], np.degrees(rows[:, 1:6])
    # Goals leave once a period; one that a busy machine notes late makes the next seem early.
    return t, q, np.diff(q, axis=0) / np.maximum(np.diff(t), PERIOD)[:, None]


def swaying(bench, joint="shoulder_pan", amplitude=40.0, period=4.0, seconds=6.0):
    """The hand sways one joint; it passes the middle at 63 deg/s."""
    t = np.arange(0.0, seconds, PERIOD)
    way = np.tile(np.degrees(bench.leader.world.q), (len(t), 1))
    way[:, JOINTS.index(joint)] += amplitude * np.sin(2.0 * np.pi * t / period)
    bench.leader.lead(way)


def mirroring(bench):
    return bench.teleop.status.phase is Phase.MIRRORING


def waiting(bench):
    return bench.teleop.status.phase is Phase.WAITING


def zeros(bench):
    """What the leader's calibration takes away from the angles its world counts [deg]."""
    return bench.leader.q_deg[:5] - np.degrees(bench.leader.world.q[:5])
