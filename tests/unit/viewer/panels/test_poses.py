import numpy as np
import pytest
from so101_viewer.panels.poses import PoseList

from so101_motion.common.errors import ConfigError
from so101_motion.files.saved_poses import SavedPoses


class FakePage:
    """Has an arm and a target, and remembers what it was told."""

    def __init__(self):
        self.q_arm = np.full(5, 0.1)
        self.target = self
        self.arms = {"": self}
        self.q = np.full(5, 0.2)
        self.aimed = []
        self.sentence = []

    def set_target_joints(self, q):
        self.aimed.append(q)

    def tell(self, sentence):
        self.sentence.append(sentence.text)

    def report(self, error):
        self.sentence.append(str(error))


@pytest.fixture
def page():
    return FakePage()


@pytest.fixture
def poses(tmp_path, page):
    return PoseList(SavedPoses(tmp_path / "poses.json"), page)


def names(poses):
    return [pose.name for pose in poses.poses]


def test_arm_and_target_can_be_saved_and_aimed_at(poses, page):
    poses.call("mine")
    poses.save_arm()
    poses.call("ghost")
    poses.save_target()
    assert names(poses) == ["mine", "ghost"]
    assert poses.chosen == "ghost"
    poses.choose("mine")
    poses.use()
    np.testing.assert_allclose(page.aimed[-1], 0.1, atol=1e-6)
    poses.choose("ghost")
    poses.use()
    np.testing.assert_allclose(page.aimed[-1], 0.2, atol=1e-6)


def test_a_pose_can_be_renamed_and_deleted(poses, page):
    poses.call("mine")
    poses.save_arm()
    poses.call("<b>other</b>")
    poses.rename()
    assert names(poses) == ["<b>other</b>"]
    assert poses.chosen == "<b>other</b>"
    poses.delete()
    assert names(poses) == []
    assert poses.chosen is None
    assert page.sentence[-1] == "Deleted <b>other</b>."
    poses.saved_files.undo()
    assert names(poses) == ["<b>other</b>"]
    assert poses.chosen == "<b>other</b>"
    poses.saved_files.undo()
    assert names(poses) == ["mine"]
    poses.call("mine")
    poses.save_target()  # in its place
    poses.saved_files.undo()
    poses.use()
    np.testing.assert_allclose(page.aimed[-1], 0.1, atol=1e-6)


def test_without_a_pose_there_is_nothing_to_use(poses):
    poses.choose("home")
    assert poses.chosen is None
    for command in (poses.use, poses.rename, poses.delete):
        with pytest.raises(ConfigError, match="save a pose first"):
            command()


def test_a_broken_file_is_reported_and_the_page_opens_all_the_same(tmp_path, page):
    (tmp_path / "poses.json").write_text("{")
    poses = PoseList(SavedPoses(tmp_path / "poses.json"), page)
    assert poses.poses == ()
    assert "is not JSON" in page.sentence[0]
