"""Episodes that the page records: LeRobot's part in a process of its own, and replayed."""

import importlib.util
import json
import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import harness.lerobot_bench  # noqa: F401  # where LeRobot is looked for
import numpy as np
import pytest

from lerobot_robot_so101_motion.episode_writer import EpisodeWriter
from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.modes import Mode
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.tasks.datasets import open_data_set
from so101_motion.tasks.datasets.episodes import EpisodeOperation

AWAY = JointGoal(q=np.radians([25.0, -20.0, 20.0, 10.0, 0.0]))


@pytest.fixture
def rig():
    with open_simulated() as rig:
        yield rig


@pytest.fixture
def operation(rig):
    operation = EpisodeOperation(rig)
    yield operation
    operation.close()


def begin(operation, folder, **changes):
    wanted = {"data_set": str(folder), "task": "Wave", "camera": "0", "fps": "30"} | changes
    operation.ask("record", **wanted)


def wait_for(condition):
    for _ in range(1200):
        if condition():
            return
        time.sleep(0.05)
    pytest.fail("did not come true")


def frames(operation):
    return operation.view.facts["frames"]


def test_what_any_motion_does_is_in_the_data_set_and_is_replayed(operation, rig, tmp_path):
    folder = tmp_path / "set"
    begin(operation, folder)
    assert operation.view.state == "recording"
    rig.arm.move(AWAY)
    rig.gripper.open()
    wait_for(lambda: frames(operation) > 20)
    facts = operation.ask("keep")
    episode = open_data_set(folder).episode(0)
    assert len(episode) == facts["frames"]
    assert episode.action[-1, :5] - episode.action[0, :5] == pytest.approx(
        np.degrees(rig.arm.state.q), abs=0.3
    )
    assert episode.action[-1, 5] == pytest.approx(100.0, abs=0.5)
    assert np.allclose(np.diff(episode.t), 1.0 / 30.0, atol=1e-4)
    assert json.loads((folder / "meta/info.json").read_text())["robot_type"] == "so101_motion"

    begin(operation, folder)
    wait_for(lambda: frames(operation) > 3)
    operation.ask("keep")
    assert open_data_set(folder).metadata.episodes == 2
    rig.arm.move(JointGoal(q=np.zeros(5)))
    assert operation.view.offers[1].title == "Replay episode 1"
    operation.ask("replay")
    assert rig.arm.state.q == pytest.approx(AWAY.q, abs=np.radians(0.5))


def test_an_episode_that_is_not_kept_leaves_the_data_set_as_it_was(operation, tmp_path):
    folder = tmp_path / "set"
    begin(operation, folder)
    wait_for(lambda: frames(operation) > 3)
    operation.ask("discard")
    assert not folder.exists()
    begin(operation, folder)
    wait_for(lambda: frames(operation) > 3)
    operation.ask("keep")

    begin(operation, folder)
    wait_for(lambda: frames(operation) > 3)
    operation._writer._child.kill()
    wait_for(lambda: "has ended" in operation.view.trouble)
    with pytest.raises(So101Error, match="has ended"):
        operation.ask("keep")
    assert operation.view.state == "idle"
    begin(operation, folder)
    wait_for(lambda: frames(operation) > 3)
    operation.close()
    assert open_data_set(folder).metadata.episodes == 1


def test_what_is_missing_or_cannot_be_opened_is_said(operation, tmp_path):
    with pytest.raises(ConfigError, match="the task is missing; say in a few words"):
        begin(operation, tmp_path / "set", task=" ")
    with pytest.raises(So101Error, match="the camera gone cannot be opened; check that it is on"):
        begin(operation, tmp_path / "set", camera="gone")
    assert operation.view.state == "idle"
    assert not list(tmp_path.iterdir())


def test_the_start_of_lerobot_can_be_cancelled_and_nothing_is_recorded_in_a_fault(
    operation, rig, tmp_path, monkeypatch
):
    with ThreadPoolExecutor() as beside:
        started = beside.submit(begin, operation, tmp_path / "set", camera="")
        wait_for(lambda: operation.view.doing == "Starting LeRobot" and operation._writer)
        (cancel,) = operation.view.offers
        operation.ask(cancel.command)
        started.result()
    assert operation.view.said[-1].text == "cancelled; nothing was recorded"
    assert operation.view.offers[0].why_not is None
    fault = replace(rig.arm.state, mode=Mode.FAULT)
    monkeypatch.setattr(type(rig.arm), "state", fault)
    assert operation.view.offers[0].why_not == "the arm is in a fault"


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"fps": 15}, "it has 30 frames a second, not 15; name another"),
        ({"camera": ""}, "it has action 6, observation.images.front 48x64x3, .* name another"),
        ({"data_set": "."}, "is there and is no data set; name another"),
    ],
)
def test_a_data_set_that_does_not_fit_is_refused(tmp_path, monkeypatch, changes, says):
    still = SimpleNamespace(monotonic=lambda: 5.0)
    monkeypatch.setattr("lerobot.cameras.opencv.time", still)  # one picture, however late it is
    here = {"data_set": str(tmp_path / "set"), "camera": "0", "fps": 30}
    writer = EpisodeWriter(**here)
    writer.begin("Wave")
    for k in range(3):
        writer.add(math.inf, [10.0 * k] * 6, [10.0 * k + 1.0] * 6)
    assert (writer.frames, writer.late) == (2, 2), "of a picture that was there before"
    writer.keep()
    episode = open_data_set(tmp_path / "set").episode(0)
    assert episode.state[:, 0].tolist() == [0.0, 10.0]
    assert episode.action[:, 0].tolist() == [11.0, 21.0], "where it is sent by the next frame"
    with pytest.raises(ValueError, match=says):
        EpisodeWriter(**here | changes)


def test_without_lerobot_it_says_what_to_install_and_offers_nothing(rig, monkeypatch):
    monkeypatch.setattr(
        "so101_motion.tasks.datasets.episodes.find_spec",
        lambda name: None if name == "lerobot" else importlib.util.find_spec(name),
    )
    view = EpisodeOperation(rig).view
    page = Path(__file__).parents[2] / "docs" / "lerobot.md"
    assert [line.strip() for line in page.read_text().splitlines() if "/bin/pip inst" in line] == [
        line for line in view.to_copy.splitlines() if "pip" in line
    ], "one recipe"
    assert not view.offers
    with pytest.raises(ConfigError):
        EpisodeOperation(rig).ask("film")
