"""What stands beside a command in a request."""

import asyncio

import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.viam.requests import commands
from so101_motion.viam.requests.commands import Taking, answer, arguments

KEYS = ("set_speed", "set_acceleration", "get_motion_params")


async def ping():
    return {"success": True}


async def set_torque(given):
    return {"enable": given.flag("enable", True)}


async def identify(given):
    return {"outline": given.flag("outline", False)}


async def by_key(request):
    given = arguments(request, KEYS)
    return {key: given.raw(key) for key in KEYS if given.given(key)}


COMMANDS = {
    "ping": ping,
    "set_torque": Taking(set_torque, ("enable",)),
    "identify": Taking(identify, ("outline", "carrying")),
}


def ask(**request):
    return asyncio.run(answer(request, COMMANDS, by_key, KEYS))


@pytest.fixture(autouse=True)
def nothing_named_yet(monkeypatch):
    monkeypatch.setattr(commands, "_named", set())


@pytest.mark.parametrize(
    ("request_", "answered"),
    [
        ({"command": "ping", "id": 3, "command_id": "a"}, {"success": True}),
        ({"command": "ping", "get_motion_params": True}, {"success": True}),
        ({"command": "set_torque", "enable": False, "timestamp": 5}, {"enable": False}),
        ({"command": "set_torque", "enable": False, "_enabled": True}, {"enable": False}),
        ({"command": "set_speed", "set_speed": 60}, {"set_speed": 60}),
        ({"command": "get_motion_params", "get_motion_params": True}, {"get_motion_params": True}),
        ({"command": "whatever", "set_acceleration": 90}, {"set_acceleration": 90}),
        ({"command": 5, "set_speed": 60, "timestamp": 1}, {"set_speed": 60}),
    ],
)
def test_what_the_published_module_takes_is_taken(request_, answered):
    assert ask(**request_) == answered


def test_what_is_ignored_is_named_in_the_log_once(caplog):
    for _ in range(3):
        ask(command="ping", timestamp=3)
        ask(set_speed=60, timestamp=3)

    assert [record.message for record in caplog.records] == [
        "ping does not take timestamp; it is ignored",
        "set_speed does not take timestamp; it is ignored",
    ]


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ({"command": "set_torque", "enabled": False}, 'did you mean "enable"'),
        ({"command": "set_torque", "enable": True, "enabel": False}, 'did you mean "enable"'),
        ({"set_speed": 60, "set_aceleration": 20}, 'did you mean "set_acceleration"'),
        ({"command": "set_speed", "set_speed": 60, "set_aceleration": 20}, "set_acceleration"),
        ({"command": "ping", "set_speed": 60}, "send it without"),
        ({"command": "set_speed", "speed": 60}, "is a key, not a command"),
        ({"command": "set_torqe", "enable": False}, 'did you mean "set_torque"'),
        ({"command": "identify", "dry_run": True}, "unknown argument"),  # it moves the arm
        ({"command": "identify", "set_speed": 60}, "unknown argument"),
        ({"command": "ping", **{f"key {i}": 1 for i in range(1000)}}, "unknown argument"),
    ],
)
def test_what_may_change_a_motion_is_never_ignored(request_, says):
    with pytest.raises(ConfigError, match=says):
        ask(**request_)
