"""An emulated arm that gets random requests, and random faults meanwhile.

The real driver and executor, the emulated servos, one simulated clock; no pseudo-terminal, so a
seed gives the same run on any machine.
"""

import math
import random
from collections import Counter
from functools import lru_cache

import numpy as np
from harness.direct_port import Socket
from harness.emulated_joints import MAPS
from harness.retarget import retarget
from referee.command import STOP_JERK, CommandCaps
from referee.official import Referee

from so101_motion.common.compliance import Compliance
from so101_motion.control.cartesian_jog import Jog
from so101_motion.control.executor import Channel, Executor, Tolerances
from so101_motion.control.following import Following
from so101_motion.control.streamed_trajectory import Stream, TimedPoint
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import FaultEvent
from so101_motion.drivers.emulator.hand import Hand, parse_script
from so101_motion.drivers.feetech import gravity_compensation
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits

DT = 0.01
LIMITS = MotionLimits.uniform(velocity=0.87, acceleration=1.75, jerk=50.0)
JAW_LIMITS = MotionLimits.uniform(velocity=1.57, acceleration=10.0, jerk=200.0, n=1)
STOP_LIMITS = MotionLimits.uniform(velocity=math.pi, acceleration=8.7, jerk=200.0)
JAW_STOP_LIMITS = MotionLimits.uniform(velocity=3.84, acceleration=24.0, jerk=600.0, n=1)
_JERK = 1.03 * STOP_JERK
"""Share of its jerk cap that a stop keeps in the cycle in which it begins. STOP_JERK is promised of
the stop itself; 1.038 was seen once where one took over from a jog."""

CAPS = (
    *((CommandCaps(50.0, 101.0, _JERK * math.degrees(200.0), braking=500.0),) * 5),
    CommandCaps(91.0, 574.0, _JERK * math.degrees(600.0), braking=1376.0),
)
_WIRE = ("loss", "request_loss", "corrupt", "duplicate")
_FAULTS = ("unplug", "dead", "reboot", "hot", "brownout")
_STALLS = (0.03, 0.2, 2.0, 10.0)  # [s] for which the process is stopped


@lru_cache(maxsize=1)
def _model():
    return RobotModel.load()


class Driver:
    """A driver that can be made anew while its executor goes on, as when a machine is configured.

    Fits ``JointDriver``.
    """

    def __init__(self, make):
        self._make, self._arm = make, make()

    def rebuild(self):
        self._arm.close()
        self._arm = self._make()

    def __getattr__(self, name):
        return getattr(self._arm, name)


class Arm:
    """The arm, its requests and its faults; all follow ``seed``.

    ``clock`` is a ``TurnClock`` that is what time it is everywhere. ``done`` counts what has been
    asked for and has happened, ``said`` has it in order, for a message.
    """

    def __init__(self, seed, clock):
        self.rng, self.clock, self.referee = random.Random(seed), clock, Referee()
        self.done, self.said = Counter(), []
        self._asleep = 0.0  # how long the computer has slept, which its clock does not know [s]
        weight = _model().gravity_torque
        self.emulator = Emulator(
            EmulatorOptions(),
            now=lambda: self.clock.now() + self._asleep,
            gravity=lambda q: 1.1 * weight(q),
            serve=self._serve,
        )
        self.match = self.referee.attend(self.emulator)
        self._fault = self._stall = None
        self._start()
        self.clock.advance(1.0)

    def _serve(self, bus):
        self.socket = Socket(bus, self.clock, lambda: self.clock.now() + self._asleep)
        self.socket.on_write = self._before_write
        return self.socket

    def _driver(self):
        driver = FeetechArm(
            self.socket.open, self.clock, MAPS, gravity=_model().gravity_torque,
            speed=math.pi, acceleration=10.0, reply_timeout=0.0,
        )  # fmt: skip
        driver.on_command = self.match.listen(
            lambda: CAPS, lambda i, q: MAPS[JOINTS[i]].to_ticks(q)
        )
        return driver

    def _start(self):
        self.executor = Executor(
            Driver(self._driver),
            self.clock,
            dt=DT,
            stop_limits=STOP_LIMITS,
            jaw_stop_limits=JAW_STOP_LIMITS,
            name="so101-io-campaign",
            tolerances=Tolerances(
                settle_position=gravity_compensation.SETTLE_POSITION,
                late_position=gravity_compensation.LEFT_ALONE,
                settle_velocity=gravity_compensation.SETTLE_VELOCITY,
                settle_timeout=gravity_compensation.SETTLE_TIMEOUT,
            ),
        )
        self.executor.requests.on_request = self.match.requested
        self.executor.start()

    def note(self, what):
        self.done[what] += 1
        self.said.append(what)

    # Requests

    def goal(self):
        return np.array([self.rng.uniform(-0.7, 0.7) for _ in range(5)])

    def move(self):
        here = self.executor.state.q_ref
        return self.executor.execute(online.point_to_point(here, self.goal(), LIMITS, DT))

    def retarget(self):
        return retarget(self.executor, self.goal(), LIMITS)

    def jaw(self):
        goal = np.array([self.rng.uniform(0.1, 1.5)])
        return retarget(self.executor, goal, JAW_LIMITS, channel=Channel.JAW)

    def stop(self):
        return self.executor.stop(self.rng.choice((None, Channel.ARM, Channel.JAW)))

    def stream(self):
        stream = self.executor.play(Stream(q_start=self.executor.state.q_ref, limits=LIMITS, dt=DT))
        here, aside = self.executor.state.q_ref, self.rng.choice((-0.02, 0.02))
        stream.push([TimedPoint(t=0.1 * k, q=here + aside * k * k / 100.0) for k in range(9)])
        if self.rng.random() < 0.5:
            stream.finish()
        return stream.future

    def jog(self):
        here, model = self.executor.state.q_ref, _model()
        servo = Servo(model, CollisionModel(model, Scene()), LIMITS, DT, here)
        jog = self.executor.play(Jog(servo, DT, lambda: self.executor.state.q_jaw_ref))
        speed = [self.rng.uniform(-0.1, 0.1) for _ in range(3)]
        if self.rng.random() < 0.5:
            jog.twist(speed)
        else:
            jog.to_point(model.frame(here, "tool").p + np.array(speed))
        return jog.future

    def follow(self):
        start, goal = self.executor.state.q_ref, self.goal()

        def each(following):
            following.aim(goal if self.clock.now() % 0.7 < 0.5 else start)

        following = Following(
            q_start=start, lower=np.full(5, -0.8), upper=np.full(5, 0.8), limits=LIMITS,
            stop_limits=STOP_LIMITS, dt=DT, each=each,
        )  # fmt: skip
        return self.executor.play(following).future

    def manual(self):
        return self.executor.guide(Compliance())

    def hold(self):
        return self.executor.hold()

    def limp(self):
        return self.executor.release()

    def torque_limit(self):
        share = self.rng.uniform(0.3, 1.0)
        return self.executor.call(lambda driver: driver.set_torque_limit("gripper", share))

    def reconfigure(self):
        return self.executor.call_and_rehold(lambda driver: driver.rebuild())

    def close(self):
        """End, in the midst of whatever it is, and begin again as a new process does."""
        self.executor.close()
        try:
            self._start()
        except Exception:  # nobody answers: a process would end, and be started again
            self.heal()
            self.clock.advance(5.0)
            self._start()

    # What befalls it

    def disturb(self):
        """Begin or end a fault."""
        if self._fault is not None:
            self.note("heal")
            self.heal()
            return
        kind = self.rng.choice(("wire", "wire", "hand", "stall", "sleep", "wall clock", *_FAULTS))
        self.note(kind)
        if kind == "wire":
            for name in _WIRE:
                setattr(self.emulator.bus.faults, name, self.rng.choice((0.0, 0.05)))
        elif kind == "hand":
            self._take_hand()
        elif kind == "stall":
            self._stall = [self.rng.randrange(40), self.rng.choice(_STALLS)]
        elif kind == "sleep":
            self._sleep(self.rng.choice((0.5, 20.0)))
        elif kind == "wall clock":
            self.clock.wall += self.rng.choice((-1e8, -3600.0, 3600.0, 1e8))
        else:
            servo = str(self.rng.randint(1, 6)) if kind in ("dead", "reboot", "hot") else None
            value = {"hot": 75.0, "brownout": 3.0}.get(kind)
            self._fault = FaultEvent(kind=kind, servo=servo, value=value)
            self.emulator.begin(self._fault)

    def _take_hand(self):
        """Somebody takes a joint of the arm, leads it away and lets go of it."""
        joint, speed = self.rng.choice(JOINTS[:5]), self.rng.uniform(30.0, 300.0)
        here = math.degrees(self.emulator.world.servo(joint).drive.q)
        goal, t = here + self.rng.choice((-1, 1)) * self.rng.uniform(10.0, 60.0), 0.1
        t += abs(goal - here) / speed
        script = f"0.1 {joint} start\n{t} {joint} {goal}\n{t + 0.3} {joint} release"
        with self.emulator.world.lock:
            self.emulator.advance()
            self.emulator.world.hand = Hand(parse_script(script), self.emulator.now())

    def _before_write(self):
        """The process may be stopped before any request to the servos, for a while."""
        if self._stall is not None:
            self._stall[0] -= 1
            if self._stall[0] < 0:
                self.clock.jump(self._stall[1])
                self._stall = None
                self.match.paused()

    def _sleep(self, seconds):
        """The lid is closed: servos go on holding; the port may be gone when it is opened."""
        self._asleep += seconds
        if self.rng.random() < 0.5:
            self.emulator.unplug()
            if self.rng.random() < 0.3:
                self.clock.advance(self.rng.choice((0.02, 1.0)))
            self.emulator.plug()
        self.emulator.advance()

    def heal(self):
        self._stall = None
        if self._fault is not None:
            self.emulator.end(self._fault)
            self._fault = None
        for name in _WIRE:
            setattr(self.emulator.bus.faults, name, 0.0)

    def recover(self):
        """Come back to a held arm."""
        self.heal()
        self.clock.advance(2.0)
        self.executor.hold()
        self.clock.advance(0.5)

    def end(self):
        self.heal()
        self.executor.close()
        self.emulator.close()
