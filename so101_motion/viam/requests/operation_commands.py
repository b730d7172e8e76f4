"""Answer the commands of operations as DoCommands.

Each command of an operation is a DoCommand under its published key. Any operation can be used as a
whole as well, which is what ``RemoteOperation`` does: ``{"command": "operation", "name": ...}``
answers its view as JSON, and with ``ask`` and ``arguments`` carries out a command.

Each command runs in a thread, because it may wait, and is finished even if the client goes away.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import msgspec

from so101_motion.common.attributes import Attributes, suggest
from so101_motion.common.errors import ConfigError
from so101_motion.common.operation import LocalOperation, arguments_of
from so101_motion.viam.requests.await_motion import run_to_end
from so101_motion.viam.requests.commands import Command, Taking


def operation_commands(
    operations: Mapping[str, LocalOperation], published: Mapping[str, tuple[str, str]]
) -> dict[str, Command]:
    """The DoCommands of operations.

    Args:
        operations: The operations by name.
        published: For each key an operation's name and its command.
    """
    answers: dict[str, Command] = {}
    for key, (name, command) in published.items():
        names = tuple(arguments_of(operations[name].commands[command]))
        answers[key] = Taking(partial(_ask, operations[name], command), names)
    whole = partial(_whole, operations)
    return {**answers, "operation": Taking(whole, ("name", "ask", "arguments"))}


async def _ask(operation: LocalOperation, command: str, given: Attributes) -> dict[str, Any]:
    values = {key: given.raw(key) for key in arguments_of(operation.commands[command])}
    known = {key: value for key, value in values.items() if given.given(key)}
    answer = await run_to_end(lambda: operation.ask(command, **known))
    return {"success": True, **answer}


async def _whole(operations: Mapping[str, LocalOperation], given: Attributes) -> dict[str, Any]:
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
    return {"answer": _text(await run_to_end(lambda: operation.ask(command, **arguments)))}


def _text(value: object) -> str:
    """JSON, because Viam's own objects keep neither order nor whole numbers nor nulls."""
    return msgspec.json.encode(value).decode()
