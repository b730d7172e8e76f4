"""Dispatch DoCommand requests to the methods that answer them.

Most requests of the published module have the key ``command``; others are keys of the request
itself and may be combined: all are checked before any is applied. What else stands in a request is
ignored there. Here it is too, and the log names it, unless it may have been meant to change a
motion: a misspelt argument, a key such as ``set_speed`` beside another command, anything beside a
command that only this module has.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Collection, Mapping
from typing import Any, NamedTuple

from so101_motion.common.attributes import Attributes, ignorable, suggest
from so101_motion.common.errors import LONGEST_QUOTE, ConfigError, clipped
from so101_motion.common.units import to_deg

_log = logging.getLogger(__name__)

Request = Mapping[str, object]


class Taking(NamedTuple):
    """A command with arguments: the method that answers it, and the arguments' names."""

    answer: Callable[[Attributes], Awaitable[dict[str, Any]]]
    names: tuple[str, ...]


Command = Taking | Callable[[], Awaitable[dict[str, Any]]]
"""The answering method of a command without arguments, or a ``Taking``."""

KEYS = ("set_speed", "set_acceleration", "get_motion_params")
"""The arm's requests without ``command``."""


_CHANGING = ("set_speed", "set_acceleration", "set")
"""Requests without ``command`` that move something or bound motions."""

_PUBLISHED = frozenset(
    {
        "set_torque", "ping", "controller_status", "diagnose", "verify_config", "reinitialize",
        "test_servo_communication", "reload_calibration", "get_calibration", "enter_manual_mode",
        "exit_manual_mode", "set_torque_limit", "servo_capabilities", "servo_move", "servo_moving",
        "servo_position", "servo_stop", "servo_wait_stop", "get_position", "set_position",
        "get_load", "calibrate_positions", "set_motion_params", "get_motion_params", "start",
        "set_homing", "start_range_recording", "stop_range_recording", "save_calibration", "abort",
        "reset", "get_current_positions", "motor_setup_discover", "motor_setup_assign_id",
        "motor_setup_verify", "motor_setup_scan_bus", "motor_setup_reset_status", "stop", "status",
    }
)  # fmt: skip
"""The commands of the published module. The others have no old clients, so anything unknown beside
them is refused."""

_named: set[tuple[str, str]] = set()  # a request, and what was ignored in it
_MOST_NAMED = 200  # so that no client can fill the log; chosen


async def answer(
    request: Request,
    commands: Mapping[str, Command],
    keys: Callable[[Request], Awaitable[dict[str, Any]]] | None = None,
    names: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Carry out ``request``; ``keys`` answers one without ``command``, which may have ``names``.

    An unknown ``command`` beside one of ``names`` is ignored, as in the published module.
    """
    command = request.get("command")
    if isinstance(command, str) and command in commands:
        known = commands[command]
        taken = known.names if isinstance(known, Taking) else ()
        given = _given(command, request, taken, names)
        return await (known.answer(given) if isinstance(known, Taking) else known())
    if keys is not None and any(name in request for name in names):
        return await keys(request)
    if command is None:
        raise ConfigError("request", dict(request), _suggestion(request, commands, names))
    hint = suggest(str(command), (*commands, *names))
    if command in names:
        hint = f'is a key, not a command: send {{"{command}": ...}}'
    if command == "get_status":
        hint = "is a method of the component, not a command: call get_status()"
    raise ConfigError("command", command, hint)


def _given(
    command: str, request: Request, taken: tuple[str, ...], names: tuple[str, ...]
) -> Attributes:
    """The arguments of a command; see above for what else may stand beside it."""
    if command not in _PUBLISHED:
        return Attributes(request, ("command", *taken), kind="argument")
    for key in _CHANGING:
        if key in request and key in names:
            reason = f"has no effect beside the command {command}; send it without a command"
            raise ConfigError(key, request[key], reason)
    return arguments(request, taken)


def arguments(request: Request, names: tuple[str, ...]) -> Attributes:
    """The arguments of a request; what else stands in it is ignored, and named in the log once."""
    others = {key: value for key, value in request.items() if key != "command"}
    ignored = ignorable(others, names, kind="argument")
    command = request.get("command")
    if command not in _PUBLISHED:
        command = next((name for name in names if name in request), "")
    for key in ignored:
        named = (str(command), clipped(key, LONGEST_QUOTE))
        if named not in _named and len(_named) < _MOST_NAMED:
            _named.add(named)
            _log.warning("%s does not take %s; it is ignored", *named)
    return Attributes({key: others[key] for key in others if key not in ignored}, names)


def _suggestion(request: Request, commands: Collection[str], names: tuple[str, ...]) -> str:
    first = next(iter(request), "")
    if first in commands:
        return f'"{first}" is a command, not a key: send {{"command": "{first}", ...}}'
    also = f" or one of {', '.join(names)}" if names else ""
    return f'send {{"command": ...}}{also}; ' + suggest(first, (*commands, *names))


def in_deg(value: float) -> float:
    """Degrees from radians, rounded so that 60 comes back as 60."""
    return round(to_deg(value), 9)
