"""Every code block of the README does what it shows, on the simulated arm."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from so101_motion.config import SimulatedArmConfig, SimulatedGripperConfig

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_there_is_one_python_example():
    assert len(blocks("python")) == 1


@pytest.mark.slow
def test_the_python_example_moves_the_arm(capsys):
    exec(compile(blocks("python")[0], "README.md", "exec"), {})
    duration, point = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"\d\.\d\d s", duration)
    np.testing.assert_allclose(
        np.fromstring(point.strip("[]"), sep=" "), [0.25, 0.12, 0.15], atol=2e-4
    )


def test_the_machine_configuration_is_accepted():
    (configuration,) = (json.loads(block) for block in blocks("json"))
    readers = {
        "devrel:so101:simulated": SimulatedArmConfig,
        "devrel:so101:simulated-gripper": SimulatedGripperConfig,
    }
    for component in configuration["components"]:
        readers[component["model"]].from_attributes(component.get("attributes", {}))


def test_every_command_that_is_shown_exists():
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    shown = re.findall(r"make (\w+)", " ".join(blocks("console")))
    assert shown
    assert set(shown) <= set(targets)


def test_every_local_link_leads_somewhere():
    links = re.findall(r"\]\(([^)#:]+)\)", README)
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []
