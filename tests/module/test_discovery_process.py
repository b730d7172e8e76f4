"""The real executable finds an arm that another process emulates, and the arm it found works."""

import asyncio
import signal
import sys

import pytest
import viam.services.discovery  # noqa: F401  # importing registers the client
from fake_parent import ARM, DISCOVERY, GRIPPER, ROOT, running_module
from grpclib import GRPCError, Status

SERVICE = "rdk:service:discovery"
EMULATE = "from so101_motion.cli import main; main()"


@pytest.fixture
async def emulated(tmp_path):
    """A link to the port of an emulated arm, in another process."""
    link = tmp_path / "blue"
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", EMULATE, "emulate", "--link", str(link),
        cwd=ROOT, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    await process.stdout.readline()
    yield str(link)
    process.send_signal(signal.SIGTERM)
    await asyncio.wait_for(process.wait(), 10.0)


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


def attributes(config):
    return dict(config.attributes.items())


async def test_what_is_discovered_can_be_added_as_it_is(emulated):
    async with running_module() as (module, _, _):
        answer = await module.validate(SERVICE, DISCOVERY)
        assert list(answer.dependencies) == []
        service = await module.add(SERVICE, DISCOVERY, {"ports": [emulated]}, "find")
        found = on(emulated, await service.discover_resources())
        assert {model: (one.name, one.api) for model, one in found.items()} == {
            "devrel:so101:arm": ("so101-arm-blue", "rdk:component:arm"),
            "devrel:so101:gripper": ("so101-gripper-blue", "rdk:component:gripper"),
            "devrel:so101:calibration": ("so101-calibration-blue", "rdk:component:sensor"),
        }
        assert attributes(found["devrel:so101:arm"]) == {"port": emulated}

        config = found["devrel:so101:arm"]
        arm = await module.add(ARM, config.model, attributes(config), config.name)
        assert len((await arm.get_joint_positions()).values) == 5

        # Beside the arm that is in use now
        again = on(emulated, await service.discover_resources())
        assert {one.name for one in again.values()} == {one.name for one in found.values()}
        report = await service.do_command({"command": "report"})
        (mine,) = [one for one in report["ports"] if one["port"] == emulated]
        assert mine["in_use"] is True
        assert mine["servo_ids"] == [1, 2, 3, 4, 5, 6]

        config = again["devrel:so101:gripper"]
        gripper = await module.add(GRIPPER, config.model, attributes(config), config.name)
        assert await gripper.is_moving() is False


async def test_nothing_to_find_is_explained(tmp_path):
    async with running_module() as (module, _, _):
        missing = str(tmp_path / "ttyACM0")
        service = await module.add(SERVICE, DISCOVERY, {"ports": [missing]}, "find")
        assert on(missing, await service.discover_resources()) == {}
        report = await service.do_command({"command": "report"})
        (mine,) = [one for one in report["ports"] if one["port"] == missing]
        assert "no such port" in mine["found"]
        assert mine["names"] == []
        assert await service.get_status() == {"ports": [missing]}
        with pytest.raises(GRPCError) as caught:
            await service.do_command({"command": "reprot"})
        assert 'did you mean "report"' in caught.value.message
    said = [message for _, message in module.parent.lines]
    assert any("no such port" in message for message in said)


async def test_wrong_settings_are_refused():
    async with running_module() as (module, _, _):
        with pytest.raises(GRPCError) as caught:
            await module.validate(SERVICE, DISCOVERY, {"port": "/dev/ttyACM0"})
        assert caught.value.status is Status.INVALID_ARGUMENT
        assert 'did you mean "ports"' in caught.value.message
