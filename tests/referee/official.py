"""The referee itself: watches emulators, passes what it sees to the judges, keeps the findings."""

import math
import time
import weakref
from contextlib import contextmanager
from dataclasses import dataclass

from referee.command import Command
from referee.joint_motion import JointMotion
from referee.packets import EVERYBODY, Writes
from referee.wire import TICK, ServoOnWire
from so101_motion.drivers.emulator.emulator import Emulator

RULES = ("travel", "limits", "distance", "seed", "stop", "motion", "command")
MOST_FINDINGS = 50


@dataclass(frozen=True)
class Caps:
    """What a motion may do at most: [deg/s] and [deg/s^2]."""

    speed: float = 180.0
    acceleration: float = 600.0


WIDEST = (*((Caps(),) * 5), Caps(220.0, 1376.0))
"""What any of the six joints may do if nobody says less: the ranges that can be configured, and
the hardest
stop of the arm and of the jaw."""


@dataclass(frozen=True)
class Finding:
    rule: str
    t: float
    place: int
    text: str

    def __str__(self):
        return f"{self.rule} at {self.t:.3f} s, servo {self.place}: {self.text}"


_matches = weakref.WeakKeyDictionary()


def match_of(emulator):
    """What the referee knows of this arm."""
    return _matches[emulator]


class Referee:
    """Watches any number of emulated arms; keeps the first fifty findings.

    ``seen`` says how many goals and samples were judged; zero means nobody was watched.
    """

    def __init__(self):
        self.findings, self.seen = [], 0

    def attend(self, emulator):
        """Watch this emulator from now on."""
        match = _matches[emulator] = Match(self, emulator)
        emulator.bus.observers.append(match.observe)
        return match

    def report(self, rule, t, place, text):
        if len(self.findings) < MOST_FINDINGS:
            self.findings.append(Finding(rule, t, place, text))

    def broken(self, but=()):
        """The findings that no rule in ``but`` excuses."""
        return [finding for finding in self.findings if finding.rule not in but]


@contextmanager
def refereed(breaks=()):
    """Watch every emulated arm that is opened in here; what breaks a rule is raised at the end.

    The rules in ``breaks`` are broken on purpose.
    """
    referee = Referee()
    Emulator.on_open.append(referee.attend)
    try:
        yield referee
    finally:
        Emulator.on_open.remove(referee.attend)
    broken = referee.broken(but=breaks)
    assert not broken, "the referee objects:\n" + "\n".join(map(str, broken))


class Match:
    """One arm under the referee's eyes; ``caps`` say what its six joints may do, base to jaw."""

    def __init__(self, referee, emulator):
        self.emulator, self.caps = emulator, WIDEST
        self._ask = None
        self._referee = referee
        self._writes = Writes()
        self._commands, self._asked = [], 0
        world = emulator.world
        # Real time: what left the driver on time may be heard late, together with its successor.
        self._jitter = 0.15 if emulator.now is time.monotonic else 0.0
        self._wire = [ServoOnWire(servo, self._reporter(i)) for i, servo in _places(world)]
        self._motion = [JointMotion(servo, self._reporter(i)) for i, servo in _places(world)]

    def _reporter(self, place):
        def report(rule, t, text):
            self._referee.report(rule, t, place, text)

        return report

    def ask_caps(self, ask):
        """``ask()`` gives the six caps in force; the widest there have been count.

        A motion planned under wider caps may still be under way when they are narrowed.
        """
        self._ask, self.caps = ask, ask()

    def _widen(self):
        if self._ask is not None:
            pairs = zip(self.caps, self._ask(), strict=True)
            self.caps = tuple(
                Caps(max(one.speed, other.speed), max(one.acceleration, other.acceleration))
                for one, other in pairs
            )

    def listen(self, caps_of, ticks_of, dt=0.01):
        """What judges the record of ``q_cmd``: call it with every command as it is sent.

        Args:
            caps_of: Gives the six ``CommandCaps`` in force.
            ticks_of: Turns joint index and angle [rad] into a position of its servo [tick].
            dt: Period of the commands [s].
        """
        judges = [Command(self._reporter(i), dt) for i in range(1, 7)]
        self._commands += judges
        servos = self.emulator.world.servos

        def sent(command):
            angles = (*command.q_cmd, command.q_jaw_cmd)
            for i, (q, judge, caps) in enumerate(zip(angles, judges, caps_of(), strict=True)):
                led_by_hand = command.is_guided and i < 5
                got_none = not command.is_seed and servos[i].memory.bytes[5] not in command.goals
                if led_by_hand or got_none or self._wire[i].is_outside:
                    judge.forget()
                    continue
                if command.is_seed:
                    judge.rest(command.t, math.degrees(q))
                    continue
                off_joint = (ticks_of(i, q) - servos[i].drive.position) * TICK
                judge.sent(command.t, math.degrees(q), caps, off_joint)

        return sent

    def requested(self, future, channels):
        """Hear of a request as it is made, and of the channels that it stops, if it is a stop.

        Once a stop has been answered, and nothing else has been asked for since, the stop rule
        holds.
        """
        self._asked += 1
        number = self._asked
        if not channels:
            self.set_off()
            return
        stopped = {channel.value for channel in channels}

        def answered(future):
            if self._asked == number and future.exception() is None:
                self.stop_answered(stopped)

        future.add_done_callback(answered)

    def stop_answered(self, channels=("arm", "jaw")):
        """Somebody was told that the arm has stopped: from now on only the ramp may come."""
        now = self.emulator.now()
        for wire in self._wire[:5] * ("arm" in channels) + self._wire[5:] * ("jaw" in channels):
            wire.stopped(now)

    def set_off(self):
        """The arm has been asked to move again."""
        for wire in self._wire:
            wire.set_off()

    def paused(self):
        """The driving process was stopped for a while; its next command begins anew."""
        for judge in self._commands:
            judge.forget()

    def observe(self, now, data):
        """A client wrote ``data``; the world has caught up and has not yet obeyed."""
        self._widen()
        world, pushed = self.emulator.world, self.emulator.world.hand.busy
        for wire, motion, caps in zip(self._wire, self._motion, self.caps, strict=True):
            wire.look(now, caps, pushed)
            motion.look(now, caps, pushed)
            self._referee.seen += 1
        for written in self._writes.feed(data):
            for servo, wire, caps in zip(world.servos, self._wire, self.caps, strict=True):
                if written.servo_id in (servo.memory.bytes[5], EVERYBODY) and servo.drive.powered:
                    wire.written(now, written, caps, self._jitter)


def _places(world):
    return enumerate(world.servos, start=1)
