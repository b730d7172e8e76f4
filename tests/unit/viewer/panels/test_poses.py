from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from so101_viewer.page.screen_state import Sentence
from so101_viewer.panels.poses import PoseList

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.files.saved_poses import SavedPoses


class PretendedPage:
    """Has an arm and a target, and remembers what it was told."""

    def __init__(self) -> None:
        self.q_arm = np.full(5, 0.1)
        self.target = self
        self.q = np.full(5, 0.2)
        self.aimed: list[Array] = []
        self.sentence: list[str] = []

    def set_target_joints(self, q: Array) -> None:
        self.aimed.append(q)

    def tell(self, sentence: Sentence) -> None:
        self.sentence.append(sentence.text)

    def report(self, error: Exception) -> None:
        self.sentence.append(str(error))


@pytest.fixture
def page() -> PretendedPage:
    return PretendedPage()


@pytest.fixture
def shelf(tmp_path: Path, page: PretendedPage) -> PoseList:
    return PoseList(SavedPoses(tmp_path / "poses.json"), page)  # type: ignore[arg-type]


def names(shelf: PoseList) -> list[str]:
    return [pose.name for pose in shelf.poses]


def test_arm_and_target_can_be_saved_and_aimed_at(shelf: PoseList, page: PretendedPage) -> None:
    shelf.call("mine")
    shelf.save_arm()
    shelf.call("ghost")
    shelf.save_target()
    assert names(shelf) == ["mine", "ghost"]
    assert shelf.chosen == "ghost"
    shelf.choose("mine")
    shelf.use()
    np.testing.assert_allclose(page.aimed[-1], 0.1, atol=1e-6)
    shelf.choose("ghost")
    shelf.use()
    np.testing.assert_allclose(page.aimed[-1], 0.2, atol=1e-6)


def test_a_pose_can_be_renamed_and_deleted(shelf: PoseList, page: PretendedPage) -> None:
    shelf.call("mine")
    shelf.save_arm()
    shelf.call("<b>other</b>")
    shelf.rename()
    assert names(shelf) == ["<b>other</b>"]
    assert shelf.chosen == "<b>other</b>"
    shelf.delete()
    assert names(shelf) == []
    assert shelf.chosen is None
    assert page.sentence[-1] == "Deleted <b>other</b>."
    shelf.shelf.undo()
    assert names(shelf) == ["<b>other</b>"]
    assert shelf.chosen == "<b>other</b>"
    shelf.shelf.undo()
    assert names(shelf) == ["mine"]
    shelf.call("mine")
    shelf.save_target()  # in its place
    shelf.shelf.undo()
    shelf.use()
    np.testing.assert_allclose(page.aimed[-1], 0.1, atol=1e-6)


def test_without_a_pose_there_is_nothing_to_use(shelf: PoseList) -> None:
    shelf.choose("home")
    assert shelf.chosen is None
    for command in (shelf.use, shelf.rename, shelf.delete):
        with pytest.raises(ConfigError, match="save a pose first"):
            command()


def test_a_broken_file_is_told_and_the_page_opens_all_the_same(
    tmp_path: Path, page: PretendedPage
) -> None:
    (tmp_path / "poses.json").write_text("{")
    shelf = PoseList(SavedPoses(tmp_path / "poses.json"), page)  # type: ignore[arg-type]
    assert shelf.poses == ()
    assert "is not JSON" in page.sentence[0]
