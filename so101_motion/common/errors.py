"""The errors that this package raises.

An error carries fields a program can act on; its message is built from them and ends with what
to do next. Errors cross a process boundary (plans are made in a worker), so they pickle with all
their fields. Mistakes of the calling program stay ``ValueError`` and ``TypeError``.
"""

from __future__ import annotations

import copy
import reprlib
from collections.abc import Iterable, Mapping
from itertools import islice
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from pathlib import Path

    from so101_motion.common.geometry import Array
    from so101_motion.common.state import JointState


LONGEST_MESSAGE = 1_000
"""Most characters of a message. Chosen: the longest of ours has half of that."""

LONGEST_QUOTE = 80
"""Most characters of a value that a message quotes. Chosen: one line of a terminal."""


def clipped(text: str, most: int) -> str:
    """``text`` cut to ``most`` characters in the middle, so that the advice at its end stays."""
    if len(text) <= most:
        return text
    tail = most // 4
    return f"{text[: most - tail - 3]}...{text[len(text) - tail :]}"


def in_series(names: Iterable[object]) -> str:
    """The names as a series: "a", "a and b", "a, b and c"."""
    *first, last = [str(name) for name in names] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def quoted(value: object) -> str:
    """``value`` as text for a message; only the beginning of a large value is read."""
    return clipped(_QUOTES.repr(value), LONGEST_QUOTE)


def _sentence(text: str) -> str:
    """A message of one line; what it quotes of a file cannot steer the terminal that shows it."""
    text = clipped(text, LONGEST_MESSAGE)
    return "".join(each if each.isprintable() else repr(each)[1:-1] for each in text)


class _Quotes(reprlib.Repr):
    """A ``repr`` that stops after as much of a value as a message shows."""

    def __init__(self) -> None:
        super().__init__()
        self.maxdict = self.maxlist = self.maxtuple = self.maxset = self.maxfrozenset = 12
        self.maxstring = self.maxother = self.maxlong = LONGEST_QUOTE

    def repr_dict(self, x: Mapping[Any, Any], level: int) -> str:  # without sorting all of it
        if not x:
            return "{}"
        if level <= 0:
            return "{...}"
        shown = [
            f"{self.repr1(key, level - 1)}: {self.repr1(value, level - 1)}"
            for key, value in islice(x.items(), self.maxdict)
        ]
        return "{" + ", ".join(shown + ["..."] * (len(x) > len(shown))) + "}"

    def repr_instance(self, x: object, level: int) -> str:
        if isinstance(x, Mapping):
            return self.repr_dict(x, level)
        if isinstance(x, str):
            return self.repr_str(str(x), level)
        return super().repr_instance(x, level)


_QUOTES = _Quotes()


def _rebuild(cls: type[So101Error], message: str, fields: dict[str, Any]) -> So101Error:
    error = cls.__new__(cls)
    Exception.__init__(error, message)
    error.__dict__.update(fields)
    return error


class So101Error(Exception):
    """Base class of errors that a user can do something about.

    ``context`` is what ``about`` has put in front of the message.
    """

    context = ""

    def __init__(self, message: str = "") -> None:
        super().__init__(_sentence(message))

    def __reduce__(self) -> tuple[Any, ...]:
        return (_rebuild, (type(self), str(self), dict(self.__dict__)))

    def about(self, what: str) -> Self:
        """A copy of the error with ``what`` in front of its message."""
        copied = copy.copy(self)
        copied.context = f"{what}: {self.context}"
        copied.args = (_sentence(f"{what}: {self}"),)
        return copied


class ConfigError(So101Error, ValueError):
    """The ``key`` of a setting or request holds a ``value`` that cannot be used.

    ``reason`` says what would be right. Where nothing was given, ``value`` is None.
    """

    def __init__(self, key: str, value: object, reason: str) -> None:
        self.key, self.value, self.reason = key, value, reason
        given = "" if value is None else f" = {quoted(value)}"
        super().__init__(f'"{clipped(key, LONGEST_QUOTE)}"{given}: {reason}')


class ChoiceNeeded(ConfigError):
    """None of those that are there was named, so waiting does not help."""


class PlanningError(So101Error):
    """There is no trajectory for this request."""


class Unreachable(PlanningError):
    """The goal lies outside what the arm can reach.

    Attributes:
        error_position: Distance from the goal to the nearest reachable point [m].
        error_angle: Angle between the goal and the nearest reachable orientation [rad].
        p_base_nearest: The nearest reachable point in the base frame, shape (3,), [m].
        q_nearest: Joint angles that reach it, shape (5,), [rad].
        limit: What stops the arm there, by name: a joint limit such as
            ``"elbow_flex at its upper limit"``, ``"full stretch"``, or None.
        fraction: For a prescribed path of the tool the share of it that can be followed, 0 to 1;
            the rest of it is ``error_position``. None where the path was free to choose.
    """

    def __init__(
        self,
        message: str,
        *,
        error_position: float,
        error_angle: float,
        p_base_nearest: Array,
        q_nearest: Array,
        limit: str | None,
        fraction: float | None = None,
    ) -> None:
        self.error_position, self.error_angle = error_position, error_angle
        self.p_base_nearest, self.q_nearest, self.limit = p_base_nearest, q_nearest, limit
        self.fraction = fraction
        super().__init__(message)


class OutsideLimits(PlanningError, ValueError):
    """A ``value`` of a ``joint`` is not within ``lower`` to ``upper`` [rad, rad/s or rad/s^2]."""

    def __init__(
        self, message: str, *, joint: str, value: float, lower: float, upper: float
    ) -> None:
        self.joint, self.value, self.lower, self.upper = joint, value, lower, upper
        super().__init__(message)


class InCollision(PlanningError):
    """The arm would touch itself or its surroundings.

    Attributes:
        first: One of the two bodies, e.g. ``"gripper"``.
        second: The other, e.g. ``"floor"``.
        where: ``"start"``, ``"goal"`` or ``"path"``.
        fraction: For a prescribed path of the tool the share of it that can be followed, 0 to 1;
            None where the path was free to choose.
        can_back_out: Whether the arm can be told to back out slowly; each surface names its own
            command for that.
    """

    def __init__(
        self,
        message: str,
        *,
        first: str,
        second: str,
        where: str,
        fraction: float | None = None,
        can_back_out: bool = False,
    ) -> None:
        self.first, self.second, self.where, self.fraction = first, second, where, fraction
        self.can_back_out = can_back_out
        super().__init__(message)


class Overloaded(PlanningError):
    """A ``joint`` would exert more ``torque`` than its ``limit`` [N m] at ``q``, (5,), [rad]."""

    def __init__(self, message: str, *, joint: str, torque: float, limit: float, q: Array) -> None:
        self.joint, self.torque, self.limit, self.q = joint, torque, limit, q
        super().__init__(message)


class NoPath(PlanningError):
    """Start and goal are free, but no path between them was found in time, or there is none.

    ``where`` is ``"start"`` or ``"goal"`` if that is shut in, else ``"path"``; ``blockers`` names
    the bodies in the way, the most frequent first.
    """

    def __init__(
        self, message: str, *, where: str = "path", blockers: tuple[str, ...] = ()
    ) -> None:
        self.where, self.blockers = where, blockers
        super().__init__(message)


class BusError(So101Error):
    """The servos cannot be reached, or their replies cannot be understood."""


class PortUnavailable(BusError):
    """A serial ``port``, as it was asked for, cannot be opened or went away, for a ``reason``."""

    def __init__(self, port: str, reason: str) -> None:
        self.port, self.reason = port, reason
        super().__init__(f"{port}: {reason}")


class NotReady(BusError):
    """The servos of a component have not answered since it was configured; it goes on trying.

    Attributes:
        reason: What is wrong.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"not ready: {reason}")


class OtherCalibration(BusError):
    """The servos hold another calibration than ``file``; nothing was written or driven."""

    def __init__(self, file: Path, reason: str) -> None:
        self.file = file
        super().__init__(reason)


class NoReply(BusError, TimeoutError):
    """A servo did not reply, although it was asked several times for a ``register``."""

    def __init__(self, message: str, *, servo_id: int, register: str) -> None:
        self.servo_id, self.register = servo_id, register
        super().__init__(message)


class CorruptReply(BusError):
    """A servo replied, but no reply was valid; ``raw`` are the bytes that came last."""

    def __init__(self, message: str, *, raw: bytes) -> None:
        self.raw = raw
        super().__init__(message)


class ServoFault(BusError):
    """A servo replies but does not obey; ``flags`` is its status byte, 0 if that shows nothing."""

    def __init__(self, message: str, *, servo_id: int, flags: int = 0) -> None:
        self.servo_id, self.flags = servo_id, flags
        super().__init__(message)


class MotionError(So101Error):
    """A motion did not end where it was meant to."""


SUPERSEDED = "a newer motion"
"""``Interrupted.by`` of a motion that a newer one replaced; any other value is a stop."""

SHUTDOWN = "shutdown"
"""``Interrupted.by`` of a motion that ended because its arm was closed."""


class CommandRefused(MotionError):
    """A command would have moved a ``joint`` too far at once, so it was not sent."""

    def __init__(self, message: str, *, joint: str) -> None:
        self.joint = joint
        super().__init__(message)


class Interrupted(MotionError):
    """A motion was ended on purpose before it arrived; the arm holds where it stopped.

    It was ended ``by`` ``SUPERSEDED``, ``"stop"``, ``"cancelled"`` or ``"shutdown"``.
    """

    def __init__(self, by: str) -> None:
        self.by = by
        holds = "" if by == SUPERSEDED else "; the arm holds where it stopped"
        super().__init__(f"the motion was ended early by {by}{holds}")


class ArmClosed(Interrupted):
    """The arm had been closed before the request was made."""

    def __init__(self) -> None:
        super().__init__(SHUTDOWN)
        self.args = ("this arm has been closed; open it again",)


class NotHolding(MotionError):
    """The arm is limp or in a fault, so it cannot be moved until it holds again."""


class FollowingError(MotionError):
    """A joint did not follow its setpoints; the arm holds.

    ``joint`` was furthest off, by ``error`` [rad]; ``recent`` has the states of the last second,
    oldest first.
    """

    def __init__(self, message: str, *, joint: str, error: float, recent: tuple[JointState, ...]):
        self.joint, self.error, self.recent = joint, error, recent
        super().__init__(message)


class ServoAlarm(MotionError):
    """The servo of a ``joint`` reports a problem, so the motion was ended; the joint holds.

    ``recent`` has the states of the last second, oldest first.
    """

    def __init__(self, joint: str, reason: str, *, recent: tuple[JointState, ...]) -> None:
        self.joint, self.reason, self.recent = joint, reason, recent
        super().__init__(f"{joint}: {reason}")


class CalibrationError(So101Error):
    """A calibration cannot be used, read or made; ``joint`` is None when it is not about one."""

    def __init__(self, joint: str | None, reason: str, next_step: str) -> None:
        self.joint, self.reason, self.next_step = joint, reason, next_step
        super().__init__(f"{joint + ': ' if joint else ''}{reason}; {next_step}")


class NotPossibleNow(So101Error):
    """An operation offers this command, but it cannot be given now."""

    def __init__(self, command: str, reason: str) -> None:
        super().__init__(f"{command}: {reason}")
        self.command, self.reason = command, reason


class MotorSetupError(So101Error):
    """A servo cannot be set up as it is connected now.

    Attributes:
        joint: Which joint's servo was wanted; None when it is not about one.
        problem: What kind: ``"no servo"``, ``"several servos"``, ``"same id"``, ``"id taken"``,
            ``"wrong model"``, ``"other servo"`` or ``"not taken"``.
        reason: What is wrong.
        next_step: What to do about it.
    """

    def __init__(self, joint: str | None, problem: str, reason: str, next_step: str) -> None:
        self.joint, self.problem = joint, problem
        self.reason, self.next_step = reason, next_step
        super().__init__(f"{joint + ': ' if joint else ''}{reason}; {next_step}")


class MachineUnavailable(So101Error):
    """A running machine cannot be reached, or went away; ``address`` is as it was asked for."""

    def __init__(self, address: str, reason: str) -> None:
        self.address, self.reason = address, reason
        super().__init__(f"machine {address}: {reason}")


class SurroundingsUnknown(PlanningError):
    """The obstacles around the arm cannot be read from the machine, so nothing is planned.

    It is about a ``component``; empty for the whole machine. The ``remedy`` ends the message.
    """

    def __init__(self, reason: str, *, component: str = "", remedy: str = "") -> None:
        self.reason, self.component = reason, component
        left_out = quoted(component or "*").replace("'", '"')
        self.remedy = remedy or (
            f'mend that, or leave it out with "ignore_components": [{left_out}] of the arm'
        )
        super().__init__(f"{reason}; {self.remedy}")


class MachineRefused(MotionError):
    """A running machine refused what it was asked for.

    ``status`` is the name of its gRPC status, such as ``"FAILED_PRECONDITION"``; ``reason`` are
    its own words.
    """

    def __init__(self, what: str, status: str, reason: str) -> None:
        self.what, self.status, self.reason = what, status, reason
        super().__init__(f"{what}: the machine says: {reason}")


class WorkerError(So101Error):
    """Planning cannot run: its process died and is restarted, or its compiled part is missing."""


def __dir__() -> list[str]:
    return sorted(
        n for n, e in globals().items() if isinstance(e, type) and issubclass(e, So101Error)
    )
