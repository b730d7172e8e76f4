"""Answer the commands of operations as DoCommands, each under its published key.

Any operation can be used as a whole as well, which is what ``RemoteOperation`` does:
``{"command": "operation", "name": ...}`` answers its view as JSON, and with ``ask`` and
``arguments`` carries out a command. Each command runs in a thread, because it may wait, and is
finished even if the client goes away. A motion that it has started ends then.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from contextvars import copy_context
from functools import partial
from typing import Any

import msgspec

from so101_motion.common.attributes import Attributes, suggest
from so101_motion.common.errors import ConfigError
from so101_motion.common.operation import LocalOperation, Moving, Started, arguments_of
from so101_motion.viam.requests.await_motion import run_to_end, wait_for_arrival
from so101_motion.viam.requests.commands import Command, Taking

_Arrived = Callable[[Moving], Awaitable[None]]


def operation_commands(
    operations: Mapping[str, LocalOperation],
    published: Mapping[str, tuple[str, str]],
    *,
    beside: Mapping[str, Any] | None = None,
    arrived: _Arrived = wait_for_arrival,
) -> dict[str, Command]:
    """The DoCommands of operations; ``published`` has an operation's name and command for each key.

    ``beside`` is added to the answers of published keys. ``arrived`` waits for a motion that a
    command has started; a cancelled wait ends the motion.
    """
    answers: dict[str, Command] = {}
    for key, (name, command) in published.items():
        names = tuple(arguments_of(operations[name].commands[command]))
        ask = partial(_ask, operations[name], command, arrived, beside or {})
        answers[key] = Taking(ask, names)
    whole = partial(_whole, operations, arrived)
    return {**answers, "operation": Taking(whole, ("name", "ask", "arguments"))}


async def _ask(
    operation: LocalOperation,
    command: str,
    arrived: _Arrived,
    beside: Mapping[str, Any],
    given: Attributes,
) -> dict[str, Any]:
    values = {key: given.raw(key) for key in arguments_of(operation.commands[command])}
    known = {key: value for key, value in values.items() if given.given(key)}
    return {**beside, **await _answer(operation, command, known, arrived)}


async def _whole(
    operations: Mapping[str, LocalOperation], arrived: _Arrived, given: Attributes
) -> dict[str, Any]:
    name = given.text("name", "")
    if name not in operations:
        raise ConfigError("name", name, suggest(name, operations))
    operation = operations[name]
    if not given.given("ask"):
        return {"view": _text(operation.view)}
    arguments = given.raw("arguments") or {}
    if not isinstance(arguments, Mapping):
        raise ConfigError("arguments", arguments, "must be an object")
    command = given.text("ask", "")
    return {"answer": _text(await _answer(operation, command, arguments, arrived))}


async def _answer(
    operation: LocalOperation, command: str, arguments: Mapping[str, Any], arrived: _Arrived
) -> Mapping[str, Any]:
    # in the request's context, so that a motion is refused if the arm was stopped meanwhile
    begin = partial(copy_context().run, partial(operation.begin, command, **arguments))
    answer = await run_to_end(begin)
    if isinstance(answer, Started):
        await arrived(answer)
        return answer.answer()
    return answer


def _text(value: object) -> str:
    """JSON, because Viam's own objects keep neither order nor whole numbers nor nulls."""
    return msgspec.json.encode(value).decode()
