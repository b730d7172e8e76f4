"""Wrong answers on the bus, in every mode of an arm: nothing impossible is believed, nothing jumps.

The real driver and the real control of the modes talk to emulated servos through ``TornPort``,
which spoils answers: it cuts them short, overwrites bytes, puts noise between them, and forges
positions with a right checksum. Time is simulated and nothing waits, so an hour of an arm takes
minutes. ``run`` plays episodes until so many answers were spoiled.

The laws are stated here once more, from the servo's data sheet and the caps, not from the driver.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from concurrent.futures import Future
from dataclasses import dataclass, field

import numpy as np
from harness.clocks import TurnClock
from harness.direct_port import DirectPort, waiting

from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import So101Error
from so101_motion.common.modes import Mode
from so101_motion.control.joint_controller import JointController
from so101_motion.control.joint_group import Channel, Tolerances
from so101_motion.control.motion_source import PlannedMotion
from so101_motion.drivers.bus.ticks import JointMap
from so101_motion.drivers.emulator.bus import Bus as EmulatedBus
from so101_motion.drivers.emulator.emulator import EmulatorOptions, build_world
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits

DT = 0.01
FASTEST = 900.0  # no joint turns faster [deg/s]
SCATTER = 0.6  # of an encoder [deg]
CAP = 30.0  # of the motions [deg/s]
HARD_CAP = 180.0  # of any command [deg/s]
TRUE_SPEED = 75.0  # what no joint may do in a motion with that cap, over 50 ms [deg/s]
SEED = 2.0  # how far from its joint a command may begin [deg]

MAPS = {joint: JointMap(servo_id=i) for i, joint in enumerate(JOINTS, start=1)}
KINDS = ("cut", "burst", "noise", "far", "near", "beyond", "status", "twice")
POSITION, READ, SYNC_READ = 56, 0x02, 0x82


@dataclass
class ReplyCounter:
    """Which answers were spoiled, and which laws were broken."""

    spoiled: Counter = field(default_factory=Counter)
    broken: list = field(default_factory=list)


class TornPort(DirectPort):
    """A port whose answers are spoiled with a probability of ``share``."""

    name = "/dev/torn"

    def __init__(self, clock, rng, counter):
        self.world = build_world(EmulatorOptions(), t=clock.now())
        super().__init__(EmulatedBus(self.world), clock.now, waiting(clock))
        self.share, self._rng, self._tally = 0.0, rng, counter

    def passed(self, request, replies):
        offset = POSITION - request[5] if request[4] in (READ, SYNC_READ) else -1
        return [self._spoil(reply.data, offset) for reply in replies]

    def _spoil(self, answer, offset):
        rng = self._rng
        if rng.random() >= self.share:
            return answer
        kind = rng.choice(KINDS)
        has_position = 0 <= offset <= len(answer) - 8
        if kind in ("far", "near", "beyond", "twice") and not has_position:
            kind = "cut"
        self._tally.spoiled[kind] += 1
        if kind == "cut":
            return answer[: -rng.randrange(1, len(answer))]
        if kind == "burst":
            at, n = rng.randrange(len(answer)), rng.randrange(1, 9)
            return answer[:at] + rng.randbytes(n) + answer[at + n :]
        if kind == "noise":
            noise = rng.choice((rng.randbytes(rng.randrange(1, 12)), b"\xff" * rng.randrange(1, 4)))
            return noise + answer if rng.random() < 0.5 else answer + noise
        if kind == "status":
            return _sealed(answer[:4] + bytes((rng.choice((1, 4, 8, 32)),)) + answer[5:-1])
        at = 5 + offset
        true = int.from_bytes(answer[at : at + 2], "little")
        forged = {
            "far": rng.randrange(4096),
            "near": (true + rng.choice((-1, 1)) * rng.randrange(60, 700)) % 4096,
            "beyond": rng.choice((4096, 5000, 0x8001, 0xFFFF, 0x7FFF, rng.randrange(4096, 65536))),
            "twice": (true + rng.randrange(60, 2000)) % 4096,
        }[kind]
        lie = _sealed(answer[:at] + forged.to_bytes(2, "little") + answer[at + 2 : -1])
        return lie + lie if kind == "twice" else lie


def _sealed(packet):
    return packet + bytes((~sum(packet[2:]) & 0xFF,))


class Episode:
    """One arm for a few seconds, in one mode after the other: its driver and its control."""

    def __init__(self, seed, share, counter, clock):
        self._rng, self._tally, self._seed = random.Random(seed), counter, seed
        self.port, self._clock, self._k = TornPort(clock, self._rng, counter), clock, 0
        self._arm = FeetechArm(
            lambda: self.port, clock, MAPS, gravity=lambda q: np.zeros(6),
            speed=math.radians(220.0), acceleration=math.radians(1000.0), reply_timeout=0.0,
        )  # fmt: skip
        self._control = JointController(
            self._arm,
            dt=DT,
            stop_limits=MotionLimits.uniform(velocity=math.pi, acceleration=10.47, jerk=200.0),
            tolerances=Tolerances(settle_position=0.006, settle_velocity=0.06),
        )
        self._control.start(0.0, holding=True)
        self._share = share
        self._believed, self._last, self._path = {}, None, []
        self._arm.on_command = self._judge_command

    def play(self):
        self.port.share = self._share
        for _ in range(6):
            acts = [self._move, self._move, self._limp, self._guide]
            if self._share:  # a servo that restarts is not heard for a while
                acts.append(self._restart)
            self._try(self._rng.choice(acts))
            self._ticks(self._rng.randrange(5, 60))
            if self._control.mode is Mode.FAULT:
                self._try(self._control.hold)

    # What it does

    def _move(self):
        if self._control.mode is not Mode.HOLDING:
            self._control.hold()
        q = self._control.state.q_ref
        goal = q + np.radians([self._rng.uniform(-25.0, 25.0) for _ in range(5)])
        goal, cap = np.clip(goal, -1.5, 1.5), math.radians(CAP)
        limits = MotionLimits.uniform(velocity=cap, acceleration=math.radians(200.0), jerk=40.0)
        self._control.k = self._k
        self._control.play(PlannedMotion(online.point_to_point(q, goal, limits, DT)), Channel.ARM)
        self._ticks(self._rng.randrange(20, 120))
        if self._control.is_moving:
            waiting = Future()
            waiting.set_running_or_notify_cancel()
            self._control.stop((Channel.ARM,), "stop", waiting)
            while self._control.is_moving:
                self._ticks(1)

    def _limp(self):
        self._control.release()
        self._ticks(self._rng.randrange(3), dt=0.05)
        self._control.hold()

    def _guide(self):
        self._control.guide(Compliance())
        self._ticks(self._rng.randrange(5, 40))
        self._control.hold()

    def _restart(self):
        self.port.world.reboot(self._rng.randrange(1, 7))
        self._ticks(40, dt=0.05)
        self._control.hold()

    def _try(self, act):
        try:
            act()
        except So101Error as error:
            if self._control.is_moving:
                self._control.fail(error)

    def _ticks(self, n, dt=DT):
        for _ in range(n):
            self._clock.advance(dt)
            self._k += 1
            self._control.k = self._k
            try:
                self._control.tick(self._clock.now(), 0)
            except So101Error as error:
                self._control.fail(error)
            self._judge_belief()
            self._judge_motion()

    # What must hold

    def _judge_belief(self):
        reading, t = self._control.state.reading, self._control.state.t
        angles = dict(zip(JOINTS, np.degrees([*reading.q, reading.q_jaw]), strict=True))
        for joint, q in angles.items():
            if joint in reading.unanswered | reading.unconfirmed:
                continue
            before = self._believed.get(joint)
            if before is not None:
                way = abs((q - before[0] + 180.0) % 360.0 - 180.0)
                if way > FASTEST * (t - before[1]) + SCATTER:
                    self._break(f"{joint} was believed to jump by {way:.1f} deg")
            self._believed[joint] = (q, t)

    def _judge_motion(self):
        self.port.world.advance(self._clock.now())
        self._path.append((self._clock.now(), np.degrees(self.port.world.q[:5])))
        (t0, q0), (t1, q1) = self._path[max(len(self._path) - 6, 0)], self._path[-1]
        if t1 - t0 >= 0.045:
            speed = np.max(np.abs(q1 - q0)) / (t1 - t0)
            if speed > TRUE_SPEED:
                self._break(f"a joint moved at {speed:.0f} deg/s")

    def _judge_command(self, command):
        q = np.degrees(command.q_cmd)
        last, self._last = self._last, command
        if command.is_guided:
            self._last = None
        elif command.is_seed:
            self.port.world.advance(self._clock.now())
            off = np.max(np.abs(q - np.degrees(self.port.world.q[:5])))
            if off > SEED:
                self._break(f"a command began {off:.1f} deg from its joint")
        elif last is not None:
            steps, dt = np.abs(q - np.degrees(last.q_cmd)), command.t - last.t
            self.port.world.advance(self._clock.now())
            off = np.abs(q - np.degrees(self.port.world.q[:5]))
            jumps = (steps > HARD_CAP * max(dt, DT) + 0.01) & (off > SEED)
            if not last.is_seed and jumps.any():
                self._break(f"the command jumped by {np.max(steps):.1f} deg in {dt:.3f} s")

    def _break(self, law):
        self._tally.broken.append((self._seed, round(self._clock.now(), 3), law))


def run(spoiled, seed):
    """Play episodes until so many answers were spoiled, few of all or half; what was seen."""
    counter, episode, share = ReplyCounter(), 0, random.Random(seed).choice((0.15, 0.5))
    while counter.spoiled.total() < spoiled and len(counter.broken) < 20:
        clock = TurnClock()
        with clock.everywhere():
            Episode(seed * 1_000_000 + episode, share, counter, clock).play()
        episode += 1
    return counter
