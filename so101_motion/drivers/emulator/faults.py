"""Faults to inject: disturbed replies, and timed faults of servos and port.

``WireFaults`` disturbs replies with given probabilities from a seeded generator: the same seed
and the same traffic give the same faults. Corruption flips one bit, which the checksum always
shows; two flips could cancel, and then no client could notice.

``FaultEvent`` is a fault with a time: from the command line's ``--fault``, or from a line typed
into a running emulator.
"""

from __future__ import annotations

import random
import re
from dataclasses import dataclass, field
from typing import Literal, get_args

from so101_motion.common.errors import ConfigError

FaultKind = Literal[
    "dead", "reboot", "hot", "brownout", "unplug", "twin", "object",
    "loss", "request_loss", "corrupt", "duplicate", "late",
    "only", "chain", "pose", "sweep", "take",
]  # fmt: skip

_NEEDS_NAME = frozenset({"dead", "reboot", "hot", "twin", "only", "take"})
_SHARES = frozenset({"loss", "request_loss", "corrupt", "duplicate", "late"})
_NEEDS_VALUE = _SHARES | {"hot", "brownout", "twin", "object"}
_MAY_HAVE_VALUE = frozenset({"sweep"})


@dataclass(slots=True, kw_only=True)
class WireFaults:
    """Disturbances of the wire; every number may be changed while it runs."""

    loss: float = 0.0  # share of replies that never arrive; the instruction was carried out
    request_loss: float = 0.0  # share of instructions that no servo hears; nothing was carried out
    lose_next: int = 0  # how many of the next replies never arrive
    corrupt: float = 0.0  # share of replies with one bit flipped
    duplicate: float = 0.0  # share of replies that arrive twice
    late: float = 0.0  # share of replies that arrive ``lateness`` after their time
    lateness: float = 0.02  # how late [s]
    seed: int = 0  # of the generator
    _random: random.Random = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in sorted(_SHARES):
            share = getattr(self, name)
            if not 0.0 <= share <= 1.0:
                raise ConfigError(name, share, "must be a share between 0 and 1")
        self._random = random.Random(self.seed)

    def _strikes(self, share: float) -> bool:
        return share > 0.0 and self._random.random() < share

    def loses_request(self) -> bool:
        return self._strikes(self.request_loss)

    def disturb(self, reply: bytes) -> list[tuple[float, bytes]]:
        """The copies of a reply that arrive, each as extra delay [s] and bytes; none if lost."""
        if self.lose_next > 0:
            self.lose_next -= 1
            return []
        if self._strikes(self.loss):
            return []
        arriving = []
        for _ in range(2 if self._strikes(self.duplicate) else 1):
            data = self._flip(reply) if self._strikes(self.corrupt) else reply
            arriving.append((self.lateness if self._strikes(self.late) else 0.0, data))
        return arriving

    def _flip(self, reply: bytes) -> bytes:
        bit = self._random.randrange(8 * len(reply))
        flipped = bytearray(reply)
        flipped[bit // 8] ^= 1 << bit % 8
        return bytes(flipped)


_FORM = re.compile(
    r"(?P<kind>[a-z_]+)(?::(?P<servo>\w+))?(?:=(?P<value>[\d.]+))?"
    r"(?:@(?P<at>[\d.]+))?(?:\+(?P<duration>[\d.]+))?"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultEvent:
    """A fault that begins at a time and may end by itself."""

    # ``dead`` (cable pulled), ``reboot``, ``hot`` [degC], ``brownout`` [V], ``unplug`` (the port),
    # ``twin`` (this servo takes the id of another), ``object`` between the jaws [m], or the name of
    # a wire fault with its share. Also actions of a person: ``only`` (leave only this servo on the
    # cable), ``chain`` (connect all), ``pose`` (hold all joints at zero), ``sweep`` (lead each
    # joint to its stops, at this speed [deg/s]) and ``take`` (take a thing away for good)
    kind: FaultKind
    servo: str | None = None  # which servo, by joint or place on the cable, or which thing
    value: float | None = None  # the number that belongs to the kind
    at: float = 0.0  # when, from the start or from being typed [s]
    duration: float | None = None  # how long it lasts [s]; None is for good


def parse_fault(text: str, *, ends: bool = False) -> FaultEvent:
    """Parse ``kind[:servo][=value][@seconds][+duration]``, e.g. ``hot:gripper=68@5+30``.

    One that ``ends`` needs no value.

    Raises:
        ConfigError: The text has another form, or something is missing.
    """
    form = _FORM.fullmatch(text.strip())
    if form is None:
        raise ConfigError("fault", text, "must look like kind[:servo][=value][@seconds][+duration]")
    kind: FaultKind | None = next((k for k in get_args(FaultKind) if k == form["kind"]), None)
    if kind is None:
        raise ConfigError("fault", text, f"kind must be one of {', '.join(get_args(FaultKind))}")
    if (kind in _NEEDS_NAME) != (form["servo"] is not None):
        what = "a thing, as in take:cube" if kind == "take" else "a servo, as in dead:elbow_flex"
        need = f"needs {what}" if kind in _NEEDS_NAME else "has no servo"
        raise ConfigError("fault", text, f"{kind} {need}")
    needs_no_value = kind in _MAY_HAVE_VALUE or (ends and form["value"] is None)
    if not needs_no_value and (kind in _NEEDS_VALUE) != (form["value"] is not None):
        need = "needs a value, as in hot:6=68" if kind in _NEEDS_VALUE else "has no value"
        raise ConfigError("fault", text, f"{kind} {need}")
    try:
        numbers = {key: float(form[key]) for key in ("value", "at", "duration") if form[key]}
    except ValueError:
        raise ConfigError("fault", text, "holds something that is not a number") from None
    if kind in _SHARES and numbers.get("value", 0.0) > 1.0:
        raise ConfigError("fault", text, "a share must be between 0 and 1")
    return FaultEvent(
        kind=kind,
        servo=form["servo"],
        value=numbers.get("value"),
        at=numbers.get("at", 0.0),
        duration=numbers.get("duration"),
    )
