"""The real executable finds an arm that another process emulates, and the arm it found works."""

import asyncio
import signal
import sys

import pytest
import viam.services.discovery  # noqa: F401  # importing registers the client
from google.protobuf import json_format
from grpclib import GRPCError, Status
from harness.fake_parent import ARM, DISCOVERY, GRIPPER, ROOT, SENSOR, running_module
from harness.in_process_module import refused

SERVICE = "rdk:service:discovery"
EMULATE = "from so101_motion.cli import main; main()"


@pytest.fixture
async def emulated(tmp_path):
    """A link to the port of an emulated arm, in another process."""
    link = tmp_path / "blue"
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", EMULATE, "emulate", "--realtime", "--link", str(link),
        cwd=ROOT, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    await process.stdout.readline()
    yield str(link)
    process.send_signal(signal.SIGTERM)
    await asyncio.wait_for(process.wait(), 60.0)


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


async def test_what_is_discovered_can_be_added_as_it_is(emulated, tmp_path):
    async with running_module() as (module, _, _):
        missing = str(tmp_path / "ttyACM0")
        await nothing_to_find_is_explained_and_wrong_settings_are_refused(module, missing)
        answer = await module.validate(SERVICE, DISCOVERY)
        assert list(answer.dependencies) == []
        service = await module.add(SERVICE, DISCOVERY, {"ports": [emulated]}, "find")
        found = await discovered(service, emulated, 3)
        assert {model: (one.name, one.api) for model, one in found.items()} == {
            "devrel:so101:arm": ("so101-arm-blue", "rdk:component:arm"),
            "devrel:so101:gripper": ("so101-gripper-blue", "rdk:component:gripper"),
            "devrel:so101:calibration": ("so101-calibration-blue", "rdk:component:sensor"),
        }
        assert attributes(found["devrel:so101:arm"]) == {"port": emulated}

        assert frame(found["devrel:so101:arm"]) == {"parent": "world"}
        assert frame(found["devrel:so101:gripper"]) == {"parent": "so101-arm-blue"}

        config = found["devrel:so101:arm"]
        arm = await module.add(ARM, config.model, attributes(config), "left")
        assert len((await arm.get_joint_positions()).values) == 5

        # Beside the arm that is in use now
        again = await discovered(service, emulated, 2)
        assert again.keys() == {"devrel:so101:gripper", "devrel:so101:calibration"}
        assert frame(again["devrel:so101:gripper"]) == {"parent": "left"}
        report = await service.do_command({"command": "report"})
        (mine,) = [one for one in report["ports"] if one["port"] == emulated]
        assert mine["in_use"] is True
        assert mine["servo_ids"] == [1, 2, 3, 4, 5, 6]

        config = again["devrel:so101:gripper"]
        gripper = await module.add(GRIPPER, config.model, attributes(config), config.name)
        assert await gripper.is_moving() is False
        config = again["devrel:so101:calibration"]
        await module.add(SENSOR, config.model, attributes(config), config.name)
        assert on(emulated, await service.discover_resources()) == {}

        diagnosis = await arm.do_command({"command": "diagnose"})
        assert not [line for line in diagnosis["findings"] if "calibration file" in line]
    said = [line for level, line in module.parent.lines if level in ("warning", "error")]
    assert not [line for line in said if "calibration" in line]
