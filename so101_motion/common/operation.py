"""Operations: the one interface of everything that takes more than one call.

A calibration, a motor setup, a program: each is an ``Operation``. It has a ``view``, which is one
immutable value of plain data that says what a person should do now and which commands are offered;
and ``ask``, which carries out a command. It knows no surface. Four adapters, each written once,
bring any operation to a person or a program: ``cli/operation_terminal.py``,
``viewer/page/operation_panel.py``, ``viam/requests/operation_commands.py`` and
``RemoteOperation`` below. How to add a command: docs/architecture.md.
"""

from __future__ import annotations

import inspect
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple, Protocol

import msgspec

from so101_motion.common.attributes import Attributes, suggest
from so101_motion.common.errors import ConfigError, NotPossibleNow, So101Error

Tone = Literal["good", "busy", "warm", "bad", "dim"]

_MOST_SAID = 20  # sentences that a view keeps; a surface that looks once a second misses none


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A line of a view: a joint, a motor, a step."""

    label: str  # what it is about
    cells: tuple[str, ...] = ()  # what is known of it, under ``View.columns`` if there are any
    text: str = ""  # what is wrong with it, or to do; empty when nothing is
    tone: Tone = "dim"
    mark: str = ""  # one character in front, such as ``"✓"``
    bar: tuple[float, float] | None = None  # begin and end of a bar, 0 to 1; None for no bar
    at: float | None = None  # where a marker stands on the bar, 0 to 1; None for no marker


@dataclass(frozen=True, slots=True, kw_only=True)
class Input:
    """A value that a person gives with a command; its argument is what is shown at first."""

    label: str
    choices: tuple[str, ...] | None = None  # what may be chosen; None to let it be typed


@dataclass(frozen=True, slots=True, kw_only=True)
class Offer:
    """A command that a person may give now: a button on a page, a key in a terminal."""

    command: str  # its name, for ``ask``
    title: str  # what it does, such as ``"Write id 6 to this motor"``
    arguments: Mapping[str, Any] = field(default_factory=dict)  # its arguments
    # those that a person may change; surfaces without fields give them as they are
    inputs: Mapping[str, Input] = field(default_factory=dict)
    why_not: str | None = None  # why it cannot be given now; None if it can
    key: str = ""  # the key for it in a terminal; the first offer has Enter
    asks: str = ""  # a question to be answered first; empty for none
    # after how long the surface gives it by itself [s]; None to wait for a person
    due_in: float | None = None
    # whether it only looks at something, so that it may be repeated and its errors need not be
    # raised
    is_look: bool = False
    cancels: bool = False  # whether it undoes everything, or ends what goes on


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """What a page may draw with the operation."""

    q: tuple[float, ...] = ()  # joint angles of the arm, then of the jaw [rad]
    ghost: tuple[float, ...] = ()  # the same of a transparent arm to be matched; empty for none
    # the same of further transparent arms, such as the ends of all stages
    ghosts: tuple[tuple[float, ...], ...] = ()
    lit: tuple[str, ...] = ()  # the joints whose links are highlighted
    lit_tone: Tone = "busy"
    note: str = ""  # how exact it is; empty when it is exact
    # places of the tool in the base frame [m]; empty for no line
    line: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """A sentence that the operation said once; the last one has the highest number."""

    number: int
    text: str
    tone: Tone = "dim"
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """An operation at one instant: plain values, ready for JSON."""

    state: str  # the state, by the operation's own names
    title: str = ""
    text: str = ""  # what a person should do now
    to_copy: str = ""  # lines for a terminal that belong to it
    columns: tuple[str, ...] = ()  # the headings of the rows' cells
    rows: tuple[Row, ...] = ()
    trouble: str = ""  # what is wrong; empty when nothing is
    fix: str = ""  # what to do about it
    note: str = ""  # small print
    doing: str = ""  # what is under way; empty when nothing is
    offers: tuple[Offer, ...] = ()  # the commands that are offered, the usual one first
    said: tuple[Said, ...] = ()  # the last sentences that were said once
    picture: Picture | None = None
    is_over: bool = False  # whether the operation has reached its end
    is_connected: bool = True  # whether what it works on can be reached
    # whatever else a program may want to know
    facts: Mapping[str, Any] = field(default_factory=dict)

    def offer(self, command: str) -> Offer | None:
        return next((offer for offer in self.offers if offer.command == command), None)

    @property
    def cancel(self) -> Offer | None:
        return next((offer for offer in self.offers if offer.cancels), None)


class Operation(ABC):
    """Something that takes more than one call, here or on another machine."""

    @property
    @abstractmethod
    def view(self) -> View:
        """The present state; never waits."""

    @abstractmethod
    def ask(self, command: str, /, **arguments: Any) -> Mapping[str, Any]:
        """Carry out a command; returns its answer, ready for JSON. May take long.

        Raises:
            ConfigError: There is no such command, or an argument is wrong.
            NotPossibleNow: It is offered, but cannot be given now.
            So101Error: As the command raised it.
        """

    def close(self) -> None:  # noqa: B027  # most have nothing to close
        """End it; anything half-way is undone."""


class Moving(Protocol):
    """A motion under way; see ``arm/motion_handle.py``."""

    @property
    def future(self) -> Future[Any]:
        """Completes when it is over."""

    @property
    def interrupt(self) -> Callable[[str], object]:
        """End it early, with why."""


class Started(NamedTuple):
    """What a command returns that has started a motion; it ends with it."""

    future: Future[Any]  # completes when the motion is over
    interrupt: Callable[[str], object]  # ends the motion early; called with why
    # returns the command's answer, once the motion has arrived
    answer: Callable[[], Mapping[str, Any]]


Command = Callable[..., Mapping[str, Any] | Started | None]
"""Carries out a command. Its annotated parameters are the command's arguments: ``str``, ``bool``,
``float``, ``int | None`` or ``tuple[str, ...]``; those without default must be given."""


class LocalOperation(Operation):
    """An operation of this process; a subclass has ``commands`` and makes the ``view``.

    Attributes:
        commands: The methods by the commands' names.
        said: The last sentences, for the view.
        refuses: Whether ``ask`` refuses what the view says cannot be given now. Operations whose
            commands are published refuse by themselves, in their own words.
    """

    refuses = True

    def __init__(self) -> None:
        self.commands: Mapping[str, Command] = {}
        self.said: tuple[Said, ...] = ()

    def say(self, text: str, tone: Tone = "dim", **facts: Any) -> None:
        """Say a sentence once, on every surface.

        Say it after ``view.state`` has changed: a page shows it until that changes again.
        """
        number = self.said[-1].number + 1 if self.said else 1
        new = Said(number=number, text=text, tone=tone, facts=facts)
        self.said = (*self.said, new)[-_MOST_SAID:]

    def ask(self, command: str, /, **arguments: Any) -> Mapping[str, Any]:
        answer = self.begin(command, **arguments)
        if isinstance(answer, Started):
            answer.future.result()
            return answer.answer()
        return answer

    def begin(self, command: str, /, **arguments: Any) -> Mapping[str, Any] | Started:
        """Carry out a command, but do not wait for a motion that it starts."""
        if command not in self.commands:
            raise ConfigError("command", command, suggest(command, self.commands))
        run = self.commands[command]
        wanted = arguments_of(run)
        given = Attributes(arguments, wanted, kind="argument")
        values = {key: _read(given, key, one) for key, one in wanted.items()}
        for offer in self.view.offers if self.refuses else ():
            if offer.command == command and offer.arguments == arguments and offer.why_not:
                raise NotPossibleNow(command, offer.why_not)
        return run(**values) or {}


def arguments_of(command: Command) -> Mapping[str, inspect.Parameter]:
    return inspect.signature(command, eval_str=True).parameters


def _read(given: Attributes, key: str, one: inspect.Parameter) -> Any:
    if not given.given(key):
        if one.default is one.empty:
            raise ConfigError(key, None, "is missing")
        return one.default
    if one.annotation is str:
        return given.text(key, "")
    if one.annotation is bool:
        return given.flag(key, False)
    if one.annotation == tuple[str, ...]:
        return given.names(key)
    value = given.required(key)
    if one.annotation is float:
        return value
    if value % 1.0 or value < 0.0:
        raise ConfigError(key, given.raw(key), "must be a whole number, 0 or more")
    return round(value)


_PERIOD = 0.12  # how often the view is read [s]; chosen: bars that move with the hand

_SEEN = 1.0  # [s]; a view that nobody has looked at for longer is not read again

Json = Mapping[str, Any]


class RemoteOperation(Operation):
    """An operation of another process, used as if it were a local one.

    While somebody looks at it, a thread reads its view several times a second, so ``view`` never
    waits. When the other side does not answer, the last view stays, with the reason as its trouble;
    the operation itself goes on over there.

    Args:
        send: Sends a request to it, such as a DoCommand, and returns the answer; raises
            ``So101Error``.
        name: The operation's name over there.
        period: How often its view is read while somebody looks at it [s].

    Raises:
        So101Error: It does not answer, or has no such operation.
    """

    def __init__(self, send: Callable[[Json], Json], name: str, *, period: float = _PERIOD) -> None:
        self._send, self._period = send, period
        self._request = {"command": "operation", "name": name}
        self._view, self._seen_at = self._read(), time.monotonic()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name=f"so101-{name}", daemon=True)
        self._thread.start()

    @property
    def view(self) -> View:
        """What was read last; never waits."""
        self._seen_at = time.monotonic()
        return self._view

    def ask(self, command: str, /, **arguments: Any) -> Json:
        try:
            answer = self._send({**self._request, "ask": command, "arguments": arguments})["answer"]
            return msgspec.json.decode(answer, type=dict[str, Any])
        finally:
            self._look()

    def close(self) -> None:
        """Stop reading; the operation goes on over there."""
        self._closing.set()
        self._thread.join()

    def _read(self) -> View:
        return msgspec.json.decode(self._send(self._request)["view"], type=View)

    def _watch(self) -> None:
        while not self._closing.wait(self._period):
            if time.monotonic() - self._seen_at < _SEEN:
                self._look()

    def _look(self) -> None:
        try:
            self._view = self._read()
        except So101Error as error:
            self._view = replace(self._view, trouble=str(error), is_connected=False)
