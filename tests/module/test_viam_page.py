"""The real module process finds an arm that another process emulates; what it found works as it is,
and answers every request of docs/viam.md as the page shows."""

import inspect
import json
import re
from functools import partial

import pytest
import viam.components.generic
import viam.services.discovery
import viam.services.generic
import viam.services.worldstatestore  # noqa: F401  # importing registers the clients
from google.protobuf import json_format
from grpclib import GRPCError, Status
from harness.emulated_port import emulated_port, patiently, works
from harness.fake_parent import (
    ARM,
    CALIBRATION,
    DISCOVERY,
    GRIPPER,
    HARDWARE_ARM,
    HARDWARE_GRIPPER,
    MOTION,
    ROOT,
    SENSOR,
    SIMULATED,
    SIMULATED_GRIPPER,
    running_module,
    until,
)
from harness.in_process_module import refused
from viam.robot.client import RobotClient
from viam.rpc.dial import DialOptions

from so101_motion.viam.models import calibration
from so101_motion.viam.models.module import MODELS

SERVICE = "rdk:service:discovery"

PAGE = (ROOT / "docs" / "viam.md").read_text()
SECTIONS = dict(re.findall(r"^## `(devrel:so101:\S+)`\n(.*?)(?=^## |\Z)", PAGE, re.M | re.S))


COMMAND = r'^            "(\w+)": (?:self\._|Taking\(|partial\(self\._)'
"""A row of a table of commands."""


def requests_of(model):
    """Pairs of what is asked and what is answered, in the page's order."""
    lines = "".join(re.findall(r"```viam\n(.*?)```", SECTIONS[model], re.S)).splitlines()
    asked = [json.loads(line[2:]) for line in lines if line.startswith("> ")]
    told = [json.loads(line[2:]) for line in lines if line.startswith("< ")]
    return list(zip(asked, told, strict=True))


def differences(told, answer, where=""):
    """Where the answer has other keys or kinds; an empty object on the page stands for any."""
    if type(told) is not type(answer):
        return [f"{where}: {type(told).__name__} is shown, {answer!r} was answered"]
    if not isinstance(told, dict) or not told:
        return []
    return [f"{where}.{key} is shown only" for key in told.keys() - answer.keys()] + [
        *(f"{where}.{key} is not shown" for key in answer.keys() - told.keys()),
        *(d for key in told.keys() & answer.keys()
          for d in differences(told[key], answer[key], f"{where}.{key}")),
    ]  # fmt: skip


def test_every_model_has_its_section():
    assert set(SECTIONS) == {str(model.model) for model in MODELS}


def test_every_command_is_documented():
    pages = PAGE + "".join(
        (ROOT / "docs" / f"{name}.md").read_text() for name in ("calibration", "teleoperation")
    )
    sources = {inspect.getsource(inspect.getmodule(model.load())) for model in MODELS}
    sources |= {
        (ROOT / "so101_motion" / "viam" / "requests" / f"{name}.py").read_text()
        for name in ("servo_commands",)
    }
    commands = {name for s in sources for name in re.findall(COMMAND, s, re.M)}
    commands |= set(calibration.COMMANDS)
    assert len(commands) > 30
    assert [name for name in sorted(commands) if name not in pages] == []


def test_the_program_of_the_first_steps_prints_what_the_page_shows(machine, monkeypatch, capsys):
    """With a plain connection, because the machine here has no key."""
    (program,) = re.findall(r"```py\n(.*?)```", PAGE, re.S)
    (shown,) = re.findall(r"```text\n(.*?)```", PAGE, re.S)
    plain = RobotClient.Options(dial_options=DialOptions(insecure=True, disable_webrtc=True))
    monkeypatch.setattr(RobotClient.Options, "with_api_key", lambda **_: plain)
    exec(program.replace("my-arm-main.abc123.viam.cloud", machine.address), {})
    assert capsys.readouterr().out == shown


@pytest.fixture(autouse=True)
def places(tmp_path, monkeypatch):
    """No calibration files but those of the test."""
    for name, folder in (("VIAM_MODULE_DATA", "data"), ("HOME", "home"), ("VIAM_HOME", "viam")):
        (tmp_path / folder).mkdir()
        monkeypatch.setenv(name, str(tmp_path / folder))


def on(port, found):
    """What was suggested for a port, by model; this machine may have real arms as well."""
    return {
        one.model: one
        for one in found
        if one.attributes.fields["port"].string_value == port
    }  # fmt: skip


async def discovered(service, port, count):
    """What was suggested for a port; looked for again while a busy machine keeps servos from being
    heard in the short time that they get."""
    for _ in range(10):
        found = on(port, await service.discover_resources())
        if len(found) == count:
            break
    return found


def attributes(config):
    return dict(config.attributes.items())


def frame(config):
    return json_format.MessageToDict(config.frame)


async def nothing_to_find_is_explained_and_wrong_settings_are_refused(module, missing):
    service = await module.add(SERVICE, DISCOVERY, {"ports": [missing]}, "nothing")
    assert on(missing, await service.discover_resources()) == {}
    report = await service.do_command({"command": "report"})
    (mine,) = [one for one in report["ports"] if one["port"] == missing]
    assert "no such port" in mine["found"]
    assert mine["names"] == []
    assert await service.get_status() == {"ports": [missing]}
    with pytest.raises(GRPCError, match='did you mean "report"'):
        await service.do_command({"command": "reprot"})

    await module.validate(SERVICE, DISCOVERY, {"port": "/dev/ttyACM0"})  # the arm's: ignored
    await refused(
        module.validate(SERVICE, DISCOVERY, {"prts": ["/dev/ttyACM0"]}),
        Status.INVALID_ARGUMENT,
        'did you mean "ports"',
    )
    assert any("no such port" in message for _, message in module.parent.lines)


async def test_what_is_discovered_can_be_added_as_it_is_and_answers_as_the_page_shows(tmp_path):
    async with emulated_port(tmp_path) as servos, running_module() as (module, _, _):
        missing = str(tmp_path / "ttyACM0")
        await nothing_to_find_is_explained_and_wrong_settings_are_refused(module, missing)
        resources = await what_is_found_can_be_added(module, servos.port)
        said = [line for level, line in module.parent.lines if level in ("warning", "error")]
        assert not [line for line in said if "calibration" in line]

        leader, follower = {"leader_arm": "left"}, {"follower_arm": "simulated"}
        for model, api, name, attributes in (
            (SIMULATED, ARM, "simulated", {}),
            (SIMULATED_GRIPPER, GRIPPER, "simulated-gripper", {}),
            ("devrel:so101:motion", MOTION, "motion", {"arm": "simulated"}),
            ("devrel:so101:teleop", "rdk:service:generic", "teleop", {**leader, **follower}),
        ):
            resources[model] = await module.add(api, model, attributes, name)
        await until(lambda: works(resources[HARDWARE_ARM].get_joint_positions))
        differ = []
        for model, resource in resources.items():
            shown = requests_of(model)
            assert shown, model
            for asked, told in shown:
                answer = json.loads(
                    json.dumps(dict(await patiently(partial(resource.do_command, asked))))
                )
                differ += differences(told, answer, f"{model} {json.dumps(asked)} ")
        assert differ == []


async def what_is_found_can_be_added(module, port):
    """Add what is found on a port; the resources by model."""
    answer = await module.validate(SERVICE, DISCOVERY)
    assert list(answer.dependencies) == []
    service = await module.add(SERVICE, DISCOVERY, {"ports": [port]}, "find")
    found = await discovered(service, port, 3)
    assert {model: (one.name, one.api) for model, one in found.items()} == {
        HARDWARE_ARM: ("so101-arm-arm", ARM),
        HARDWARE_GRIPPER: ("so101-gripper-arm", GRIPPER),
        CALIBRATION: ("so101-calibration-arm", SENSOR),
    }
    assert attributes(found[HARDWARE_ARM]) == {"port": port}
    assert frame(found[HARDWARE_ARM]) == {"parent": "world"}
    assert frame(found[HARDWARE_GRIPPER]) == {"parent": "so101-arm-arm"}
    arm = await module.add(ARM, HARDWARE_ARM, attributes(found[HARDWARE_ARM]), "left")
    await until(lambda: works(arm.get_joint_positions))
    assert len((await arm.get_joint_positions()).values) == 5

    # Beside the arm that is in use now
    again = await discovered(service, port, 2)
    assert again.keys() == {HARDWARE_GRIPPER, CALIBRATION}
    assert frame(again[HARDWARE_GRIPPER]) == {"parent": "left"}
    report = await service.do_command({"command": "report"})
    (mine,) = [one for one in report["ports"] if one["port"] == port]
    assert mine["in_use"] is True
    assert mine["servo_ids"] == [1, 2, 3, 4, 5, 6]

    resources = {HARDWARE_ARM: arm, DISCOVERY: service}
    for model, api in ((HARDWARE_GRIPPER, GRIPPER), (CALIBRATION, SENSOR)):
        config = again[model]
        resources[model] = await module.add(api, model, attributes(config), config.name)
    assert await resources[HARDWARE_GRIPPER].is_moving() is False
    assert on(port, await service.discover_resources()) == {}
    diagnosis = await arm.do_command({"command": "diagnose"})
    assert not [line for line in diagnosis["findings"] if "calibration file" in line]
    return resources
