"""What users hold and call has in common: a short ``dir``, no misspelt names, clear errors."""

from __future__ import annotations

from abc import ABCMeta
from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import TYPE_CHECKING, Any, ClassVar, ParamSpec, TypeVar

from so101_motion.common.attributes import suggest

P = ParamSpec("P")
T = TypeVar("T")


def explained(otherwise: str, **meant: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Let the ``TypeError`` of a call with wrong arguments say what to write instead.

    ``meant``: that for an argument which it does not have; ``otherwise``, for all else, may have a
    ``{}`` for the arguments that it has.
    """

    def explain(function: Callable[P, T]) -> Callable[P, T]:
        @wraps(function)
        def call(*args: P.args, **named: P.kwargs) -> T:
            try:
                return function(*args, **named)
            except TypeError as error:
                if error.__traceback__ is None or error.__traceback__.tb_next is not None:
                    raise  # from within
                takes = ", ".join(each for each in signature(function).parameters if each != "self")
                hint = next((meant[each] for each in named if each in meant), otherwise)
                raise TypeError(f"{error}; {hint.format(takes)}") from None

        return call

    return explain


class Public:
    """``dir`` lists the names for programs of users: ``_shown``, or all without an underscore."""

    __slots__ = ()
    _shown: ClassVar[str] = ""

    def __dir__(self) -> list[str]:
        return self._shown.split() or [n for n in object.__dir__(self) if not n.startswith("_")]

    if not TYPE_CHECKING:  # or any name would be right for a type checker

        def __getattr__(self, name: str) -> Any:
            raise _unknown(self, name)


def _unknown(of: object, name: str) -> AttributeError:
    """The error for a name that is none, with the names there are for users."""
    text = f"{type(of).__name__} has no {name!r}"
    if not name.startswith("_"):
        text = f"{text}; {suggest(name, dir(of))}"
    return AttributeError(text, name=name)


class _MakesComplete(ABCMeta):
    def __call__(cls, *args: Any, **options: Any) -> Any:
        made = super().__call__(*args, **options)
        made._is_complete = True
        return made


class Complete(Public, metaclass=_MakesComplete):
    """Once made, it takes no new public attribute, which would be a misspelt one."""

    _is_complete = False

    def __setattr__(self, name: str, value: object) -> None:
        is_known = name.startswith("_") or name in self.__dict__ or hasattr(type(self), name)
        if self._is_complete and not is_known:
            raise _unknown(self, name)
        known = getattr(type(self), name, None)
        if isinstance(known, property) and known.fset is None and hasattr(self, f"set_{name}"):
            raise AttributeError(f"{name} is read; set_{name}(...) sets it", name=name)
        super().__setattr__(name, value)
