"""Read and check settings that arrive as JSON values by name.

An error for an unknown name suggests the nearest known one; an error for a wrong value says what
was given and what is allowed. Numbers arrive as floats, because that is how Viam carries them. An
empty string and a null count as not given, as they did for the published module.
"""

from __future__ import annotations

import difflib
import inspect
import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from functools import lru_cache
from numbers import Real
from typing import Any, ClassVar, Self, TypeVar

import so101_description

from so101_motion.common.errors import ConfigError
from so101_motion.common.units import to_m, to_rad

T = TypeVar("T")

ABOVE_ZERO = math.ulp(0.0)  # the lower bound of numbers that must be more than 0

SPEED_RANGE_DEG = (3.0, 180.0)  # joint speeds that can be set [deg/s]; the published module's range

ACCELERATION_RANGE_DEG = (10.0, 500.0)
"""Joint accelerations that can be set [deg/s^2]; the published module's range."""

SERVO_VOLTAGES = tuple(so101_description.ROBOT.stall)
"""Rated voltages of the servos the arm is sold with [V], the default first: from the robot file."""

HEAVIEST = 5.0  # largest payload that is accepted [kg]; a larger number was probably meant as grams

_TO_SI: Mapping[str, Callable[[float], float]] = {
    "mm": to_m, "deg": to_rad, "deg/s": to_rad, "deg/s^2": to_rad,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Attribute:
    """One attribute of a model: how to parse it."""

    name: str  # as users write it
    _: KW_ONLY
    # ``"number"``, ``"whole"``, ``"numbers"``, ``"flag"``, ``"text"``, ``"names"``, ``"choice"`` or
    # ``"objects"``; ``"own"`` is read by code of its own
    kind: str = "number"
    unit: str = ""  # of a number as users write it
    range: tuple[float, float] = (-math.inf, math.inf)  # the smallest and the largest number
    default: float | bool | None = None  # the value used when it is not given, in ``unit``
    zero_is_none: bool = False  # whether 0 counts as not given, as in the published module
    # whether a positive number outside the range becomes the nearest in it
    takes_nearest: bool = False
    count: int = 0  # most entries of a list of numbers; 0 for any
    options: tuple[str, ...] = ()  # what a choice may be, the default first
    ours: bool = False  # whether only this module has it, not the published one
    idle: str = ""  # why it has no effect; empty if it has one


SPEED_CAP = Attribute(
    "speed_degs_per_sec", unit="deg/s", range=SPEED_RANGE_DEG, default=SPEED_RANGE_DEG[1], ours=True
)
ACCELERATION_CAP = Attribute(
    "acceleration_degs_per_sec_per_sec",
    unit="deg/s^2",
    range=ACCELERATION_RANGE_DEG,
    default=ACCELERATION_RANGE_DEG[1],
    ours=True,
)


class Attributes:
    """Named values; each is checked when it is read: ``ConfigError`` for what cannot be used.

    Args:
        values: What was given.
        known: Every name that may occur, or attributes, which ``value`` then reads.
        kind: What a name is called in messages.
    """

    def __init__(
        self,
        values: Mapping[str, object],
        known: Iterable[str | Attribute],
        *,
        kind: str = "attribute",
    ) -> None:
        self._values = values
        self._table = {each.name: each for each in known if isinstance(each, Attribute)}
        names = tuple(each if isinstance(each, str) else each.name for each in known)
        for key, value in values.items():
            if key not in names:
                raise ConfigError(key, value, f"unknown {kind}; {suggest(key, names)}")

    def given(self, key: str) -> bool:
        """Whether there is a value under ``key``; null and the empty string are none."""
        return self._values.get(key) not in (None, "")

    def raw(self, key: str) -> object:
        return self._values.get(key)

    @property
    def idle(self) -> tuple[str, ...]:
        """The given attributes that have no effect."""
        return tuple(key for key, each in self._table.items() if each.idle and self.given(key))

    @property
    def notes(self) -> tuple[str, ...]:
        """The given numbers that are outside their range, and what is used instead."""
        return tuple(
            f"{key} is {given:.10g}; {nearest:.10g} is used, the nearest"
            f" of{_range(*each.range, each.unit).removeprefix(' from')}"
            for key, each in self._table.items()
            if each.takes_nearest
            and self.given(key)
            and (given := checked_number(key, self._values[key])) != 0.0
            and given != (nearest := min(max(given, each.range[0]), each.range[1]))
        )

    def value(self, key: str) -> Any:
        """The value of an attribute, checked as its row says, in SI units.

        None or empty if it was not given and has no default.
        """
        row = self._table[key]
        if row.kind == "flag":
            return self.flag(key, bool(row.default))
        if row.kind == "choice":
            return self.choice(key, row.options)
        if row.kind == "text":
            return self.text(key, "") or None
        if row.kind == "names":
            return self.names(key)
        if row.kind == "objects":
            return self.objects(key)
        convert = _TO_SI.get(row.unit, float)
        lower, upper = row.range
        if row.kind == "numbers":
            given = self.numbers(key, count=row.count, lower=lower, upper=upper)
            return tuple(convert(number) for number in given)
        raw, number = self._values.get(key), row.default
        if self.given(key) and not (row.zero_is_none and raw == 0 and raw is not False):
            takes_nearest = row.takes_nearest and isinstance(raw, (int, float))
            least, most = (0.0, math.inf) if takes_nearest else row.range
            number = checked_number(key, raw, lower=least, upper=most, unit=row.unit)
            number = min(max(number, lower), upper)
        if row.kind != "whole" or number is None:
            return None if number is None else convert(number)
        if number != round(number):
            raise ConfigError(key, raw, f"must be a whole number{_range(lower, upper, row.unit)}")
        return round(number)

    def number(
        self, key: str, default: float, *, lower: float, upper: float, unit: str = ""
    ) -> float:
        return (
            self.required(key, lower=lower, upper=upper, unit=unit) if self.given(key) else default
        )

    def required(
        self, key: str, *, lower: float = -math.inf, upper: float = math.inf, unit: str = ""
    ) -> float:
        """A finite number within bounds that must be given."""
        return checked_number(key, self._values.get(key), lower=lower, upper=upper, unit=unit)

    def numbers(self, key: str, *, count: int, lower: float, upper: float) -> tuple[float, ...]:
        """Finite numbers within bounds, at most ``count`` (0: any number of them); or none."""
        most = f" of at most {count} numbers" if count else " of numbers"
        value = self._checked(
            key, (), lambda v: _is_list(v) and not len(v) > count > 0, f"must be a list{most}"
        )
        return tuple(
            checked_number(f"{key}[{i}]", entry, lower=lower, upper=upper)
            for i, entry in enumerate(value)
        )

    def triple(self, key: str, most: float) -> tuple[float, float, float]:
        """Three numbers from ``-most`` to ``most``; zeros when not given."""
        if not self.given(key):
            return (0.0, 0.0, 0.0)
        numbers = self.numbers(key, count=3, lower=-most, upper=most)
        if len(numbers) != 3:
            raise ConfigError(key, list(numbers), "must be three numbers")
        return numbers

    def angles(self, key: str, joints: Sequence[str]) -> dict[str, float]:
        """Joint angles in degrees, from an object by joint or a list of all, base to wrist."""
        value = self._values.get(key)
        if isinstance(value, Mapping):
            named = Attributes(value, joints, kind=f"joint of {key}")
            return {
                joint: named.number(joint, 0.0, lower=-180.0, upper=180.0, unit="deg")
                for joint in joints
                if named.given(joint)
            }
        listed = self.numbers(key, count=len(joints), lower=-180.0, upper=180.0)
        if self.given(key) and len(listed) != len(joints):
            reason = "must list five angles, base to wrist, or be an object by joint"
            raise ConfigError(key, value, reason)
        return dict(zip(joints, listed, strict=False))

    def objects(self, key: str) -> tuple[Mapping[str, object], ...]:
        wanted = 'must be a list of objects, [{"name": "mug", ...}]'
        return tuple(self._checked(key, (), lambda v: _is_list(v, Mapping), wanted))

    def flag(self, key: str, default: bool) -> bool:
        """A boolean; a number or a string such as "true" is refused."""
        found: bool = self._checked(
            key, default, lambda v: isinstance(v, bool), "must be true or false"
        )
        return found

    def text(self, key: str, default: str) -> str:
        found: str = self._checked(key, default, lambda v: isinstance(v, str), "must be a string")
        return found

    def names(self, key: str) -> tuple[str, ...]:
        return tuple(self._checked(key, (), lambda v: _is_list(v, str), "must be a list of names"))

    def choice(self, key: str, options: tuple[str, ...]) -> str:
        """One of ``options``; the first when not given."""
        value = self.text(key, options[0])
        if value not in options:
            raise ConfigError(key, value, suggest(value, options))
        return value

    def _checked(self, key: str, default: Any, is_right: Callable[[Any], bool], reason: str) -> Any:
        if not self.given(key):
            return default
        if not is_right(self._values[key]):
            raise ConfigError(key, self._values[key], reason)
        return self._values[key]


def _is_list(value: object, of: type = object) -> bool:
    return isinstance(value, (list, tuple)) and all(isinstance(entry, of) for entry in value)


class Config:
    """Base of settings that are read from attributes: dataclasses whose fields say from which."""

    __slots__ = ()
    # attributes that are only checked, and have no field
    CHECKED: ClassVar[tuple[Attribute, ...]] = ()

    @classmethod
    def rows(cls) -> tuple[Attribute, ...]:
        """Its attributes: those of its own fields, then those of its bases, then those checked."""
        order = [name for base in cls.__mro__ for name in inspect.get_annotations(base)]
        sources = sorted(_sources(cls), key=lambda each: order.index(each[0]))
        return tuple(row for _, source in sources for row in source["rows"]) + cls.CHECKED

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> Self:
        """Read and check the attributes; raises ``ConfigError`` for what cannot be used."""
        given = Attributes(attributes, cls.rows())
        for row in cls.CHECKED:
            given.value(row.name)
        return cls.read(given)

    @classmethod
    def read(cls, given: Attributes) -> Self:
        """Read the fields; raises ``ConfigError`` for what cannot be used."""
        return cls(**{
            name: source["by"](given, next((row.name for row in source["rows"]), ""))
            for name, source in _sources(cls)
        })  # fmt: skip


def _sources(config: type[Config]) -> list[tuple[str, Mapping[str, Any]]]:
    return [(each.name, each.metadata) for each in fields(config)]  # type: ignore[arg-type]


Reader = Callable[[Attributes, str], Any]
"""Reads a field from the given attributes and the name of its first one."""


def derived(by: Reader, *rows: Attribute) -> Any:
    """A field of a ``Config`` that ``by`` reads; ``rows`` are its attributes."""
    return field(metadata={"rows": rows, "by": by})


def attribute(name: str, *, by: Reader = Attributes.value, **row: Any) -> Any:
    """A field of a ``Config`` with an attribute; ``by`` reads it if its row does not say how."""
    return derived(by, Attribute(name, **row))


def changed(config: type[Config], name: str, **changes: Any) -> Any:
    """The field ``name`` of a base with a changed attribute."""
    source = dict(_sources(config))[name]
    return derived(source["by"], replace(source["rows"][0], **changes))


def part(config: type[Config], *, only_with: str = "", **changes: Mapping[str, Any]) -> Any:
    """A field with settings of their own, which are read from the same attributes.

    Args:
        config: Their class.
        only_with: The attribute without which there are none (None).
        changes: What differs in the attributes of its fields, by field.
    """
    rows = tuple(
        replace(source["rows"][0], **changes.get(name, {})) for name, source in _sources(config)
    )
    return derived(
        lambda given, _: config.read(given) if not only_with or given.given(only_with) else None,
        *rows,
    )


def checked_kind(key: str, value: T, kind: Any, what: str) -> T:
    """``value``; ``ConfigError``, with ``what`` it must be, if it is not of that kind."""
    if not isinstance(value, kind):
        raise ConfigError(key, value, f"must be {what}")
    return value


def checked_number(
    key: str, value: object, *, lower: float = -math.inf, upper: float = math.inf, unit: str = ""
) -> float:
    """``value`` as a float; ``ConfigError``, with the range, if it is not finite or out of it."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ConfigError(key, value, f"must be a number{_range(lower, upper, unit)}")
    try:
        is_finite = math.isfinite(value)
    except OverflowError:  # a whole number above 1e308, as JSON may have it
        is_finite = False
    if not is_finite:
        raise ConfigError(key, value, f"must be a finite number{_range(lower, upper, unit)}")
    if not lower <= float(value) <= upper:
        raise ConfigError(key, value, f"out of range; must be a number{_range(lower, upper, unit)}")
    return float(value)


_LONGEST_WORD = 64
"""Longer words are not compared with known ones [characters]. The time to compare grows with the
square of the length: two seconds for 100,000 characters. Chosen; the longest known word has 40."""

_MOST_WORDS = 250
"""If more words than this are known, no nearest one is searched, and only so many are listed.
Chosen."""


def suggest(word: str, known: Iterable[str]) -> str:
    """Text that suggests the known word that was probably meant, and lists all known words."""
    names = tuple(dict.fromkeys(known))
    if not names:
        return "none is known here"
    if len(names) > _MOST_WORDS:
        return f"known: {', '.join(names[:_MOST_WORDS])} and {len(names) - _MOST_WORDS} more"
    near = nearest(word, names)
    hint = f'did you mean "{near}"? ' if near else ""
    return hint + "known: " + ", ".join(names)


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word that ``word`` was probably meant as; empty if it resembles none."""
    shares = {n: _likeness(word, n) for n in known if max(len(word), len(n)) <= _LONGEST_WORD}
    near = max(shares, key=lambda name: shares[name], default="")
    return near if near and shares[near] >= 0.6 else ""


def ignorable(
    values: Mapping[str, object],
    known: Iterable[str],
    *,
    elsewhere: Container[str] = (),
    kind: str = "attribute",
) -> tuple[str, ...]:
    """The unknown names among ``values`` that can be left out, as the published module does.

    A name that looks like a misspelt known one is refused: what it stands for may bound a motion.
    So are so many that they are not compared. Names that are known ``elsewhere`` are well spelt.
    """
    names = tuple(known)
    unknown = tuple(key for key in values if key not in names)
    for key in unknown:
        if len(unknown) > _MOST_IGNORED or misspelt(key, names, elsewhere):
            raise ConfigError(key, values[key], f"unknown {kind}; {suggest(key, names)}")
    return unknown


def misspelt(word: str, known: Iterable[str], elsewhere: Container[str] = ()) -> str:
    """The known name that an unknown one is a misspelling of; empty if it seems meant as it is."""
    if word in elsewhere or word.startswith(_COMMENT) or word.lower() in _REMARKS:
        return ""
    return nearest(word, known)


_COMMENT = ("_", "#", "/")
"""A name that begins so is a comment, or was taken out by whoever wrote it."""

_REMARKS = frozenset(
    {
        "comment", "comments", "debug", "description", "label", "location", "model", "name", "note",
        "notes", "version",
    }
)  # fmt: skip
"""Names of remarks that people write beside settings; some resemble an attribute. Chosen."""

_MOST_IGNORED = 20
"""If more names than this are unknown, they are refused: to compare them takes long. Chosen."""


@lru_cache(maxsize=4096)
def _likeness(word: str, name: str) -> float:
    """Similarity of two words, 0 to 1; "speed" is like "speed_degs_per_sec" by its first part.

    Cached: a configuration is checked in a thread first, and the event loop then uses the results.
    """

    def ratio(other: str) -> float:
        return difflib.SequenceMatcher(None, word.lower(), other).ratio()

    return max(ratio(name.lower()), 0.8 * max(ratio(part) for part in name.lower().split("_")))


def _range(lower: float, upper: float, unit: str) -> str:
    behind = f" {unit}" if unit else ""
    if math.isinf(lower) and math.isinf(upper):
        return f" [{unit}]" if unit else ""
    if lower == ABOVE_ZERO:
        most = "" if math.isinf(upper) else f" and at most {upper:.10g}"
        return f" of more than 0{most}{behind}"
    if math.isinf(upper):
        return f" of at least {lower:g}{behind}"
    return f" from {lower:.10g} to {upper:.10g}{behind}"


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadConfig:
    """The load that an arm always carries, and the rated voltage of its servos."""

    mass: float = 0.0  # mass of the load in the gripper [kg]
    # its centre of mass in the tool frame, x, y, z [m]; None for the jaw's tip
    com: tuple[float, float, float] | None = None
    # the servos' rated voltage, one of ``SERVO_VOLTAGES`` [V]
    servo_voltage: float = SERVO_VOLTAGES[0]
