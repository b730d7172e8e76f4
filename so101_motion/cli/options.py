"""Declare a verb's options once: as the defaults of its function's parameters.

::

    @verb(calibration)
    def write(
        file: str = argument(shell_complete=completed_files),
        port: str | None = port_option("Serial port of the arm"),
        yes: bool = flag("Write without asking."),
    ) -> None: ...

``together`` makes one value, which several verbs take, of several options.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import click


class _Declared(NamedTuple):
    """One option, or several that make one value."""

    # makes click's parameters for the function's parameter of a name
    parameters: Callable[[str], list[click.Parameter]]
    # takes the value of that parameter from those that click has read
    value: Callable[[str, Mapping[str, Any]], Any]


def option(help: str, type: Any = None, default: Any = None, *, name: str = "", **more: Any) -> Any:
    """Declare an option, called like its parameter or ``name``; the help shows its ``default``.

    ``type`` and ``more`` are for ``click.Option``.
    """
    if default is not None:
        more = {"default": default, "show_default": True, **more}

    def parameters(parameter: str) -> list[click.Parameter]:
        called = name or f"--{parameter.replace('_', '-')}"
        return [click.Option([called, parameter], type=type, help=help, **more)]

    return _Declared(parameters, lambda parameter, given: given[parameter])


def flag(help: str, *, name: str = "") -> Any:
    return option(help, name=name, is_flag=True)


def argument(type: Any = None, **more: Any) -> Any:
    """Declare an argument; ``more`` is for ``click.Argument``."""
    return _Declared(
        lambda parameter: [click.Argument([parameter], type=type, **more)],
        lambda parameter, given: given[parameter],
    )


def together(make: Callable[..., object], **options: Any) -> Any:
    """Declare one value that ``make`` makes of several options, which it takes by their names."""

    def value(_: str, given: Mapping[str, Any]) -> object:
        return make(**{name: each.value(name, given) for name, each in options.items()})

    return _Declared(
        lambda _: [made for name, each in options.items() for made in each.parameters(name)], value
    )


def verb(
    group: click.Group | None = None, name: str | None = None
) -> Callable[[Callable[..., object]], click.Command]:
    """Make a command, of ``group`` if given, of a function whose defaults are declared options."""

    def made(function: Callable[..., object]) -> click.Command:
        defaults = inspect.signature(function).parameters.items()
        declared = together(function, **{key: each.default for key, each in defaults})

        @functools.wraps(function)
        def call(**given: Any) -> object:
            return declared.value("", given)

        command = click.command if group is None else group.command
        return command(name, params=declared.parameters(""))(call)

    return made


JSON = flag("One JSON object on stdout.", name="--json")
DRY_RUN = flag("Print what would be done, and write nothing.")
YES, START = flag("Move without asking."), flag("Start without asking.", name="--yes")
EVENTS = option(
    "Write every message to this file, as JSON lines.",
    click.File("w", encoding="utf-8", lazy=False),
)
