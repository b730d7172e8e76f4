"""The real module process answers every request of docs/viam.md as the page shows."""

import inspect
import json
import re
from functools import partial
from textwrap import dedent, indent
from types import SimpleNamespace

import pytest
import viam.components.generic
import viam.services.discovery
import viam.services.generic
import viam.services.worldstatestore  # noqa: F401  # importing registers the clients
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

from so101_motion.viam.models import calibration
from so101_motion.viam.models.module import MODELS

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


async def test_the_answers_are_as_shown(tmp_path):
    async with emulated_port(tmp_path) as servos, running_module() as (module, _, _):
        port = {"port": servos.port}
        leader, follower = {"leader_arm": "arm"}, {"follower_arm": "simulated"}
        machine = [
            (HARDWARE_ARM, ARM, "arm", port),
            (HARDWARE_GRIPPER, GRIPPER, "gripper", port),
            (CALIBRATION, SENSOR, "calibration", port),
            (SIMULATED, ARM, "simulated", {}),
            (SIMULATED_GRIPPER, GRIPPER, "simulated-gripper", {}),
            (DISCOVERY, "rdk:service:discovery", "discovery", {}),
            ("devrel:so101:motion", MOTION, "motion", {"arm": "simulated"}),
            ("devrel:so101:teleop", "rdk:service:generic", "teleop", {**leader, **follower}),
        ]
        differ = []
        resources = {}
        for model, api, name, attributes in machine:
            resources[model] = await module.add(api, model, attributes, name)
        await until(lambda: works(resources[HARDWARE_ARM].get_joint_positions))
        for model, resource in resources.items():
            shown = requests_of(model)
            assert shown, model
            for asked, told in shown:
                answer = json.loads(
                    json.dumps(dict(await patiently(partial(resource.do_command, asked))))
                )
                differ += differences(told, answer, f"{model} {json.dumps(asked)} ")
        assert differ == []


async def test_the_first_steps_move_the_arm(capsys):
    (shown,) = re.findall(r"```py\n(.*?)```", PAGE, re.S)
    steps = "async def steps(machine):\n" + indent(dedent(shown.rstrip(" ")), "    ")
    async with running_module() as (module, _, _):
        resources = {
            "arm": await module.add(ARM, SIMULATED, {"speed_degs_per_sec": 180}, "arm"),
            "gripper": await module.add(GRIPPER, SIMULATED_GRIPPER, {}, "gripper"),
        }
        exec(steps, known := {})
        await known["steps"](SimpleNamespace(get_component=lambda name: resources[name.name]))
    said = dict(re.findall(r"^([xyz]): (\S+)", capsys.readouterr().out, re.M))
    assert [float(said[axis]) for axis in "xyz"] == pytest.approx([250.0, 100.0, 150.0], abs=0.5)
