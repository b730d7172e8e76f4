import numpy as np
import pytest
from so101_viewer.page.history import SavedFiles
from so101_viewer.panels.poses import PoseList

from so101_motion.common.errors import ConfigError
from so101_motion.files.saved_poses import SavedPoses


@pytest.fixture
def told():
    return []


@pytest.fixture
def files(tmp_path, told):
    return SavedFiles(
        lambda name: tmp_path / name,
        lambda: tuple(sorted(file.name for file in tmp_path.iterdir() if file.suffix != ".lock")),
        lambda sentence: told.append(sentence.text),
    )


def put(files, name, text):
    with files.changing(name) as file:
        file.write_text(text)


def held(folder):
    return {file.name: file.read_text() for file in folder.iterdir() if file.suffix == ".txt"}


def test_what_was_written_over_and_deleted_comes_back_in_turn(files, told, tmp_path):
    put(files, "a.txt", "one")
    put(files, "a.txt", "two")
    with files.changing("a.txt") as file:
        file.unlink()
    stages = [{"a.txt": "two"}, {"a.txt": "one"}, {}]
    for stage in stages:
        assert files.can_undo
        files.undo()
        assert held(tmp_path) == stage
        assert ("a.txt" in files.names) is bool(stage)
    assert not files.can_undo
    files.undo()
    for stage in ({"a.txt": "one"}, {"a.txt": "two"}, {}):
        files.redo()
        assert held(tmp_path) == stage
    assert not files.can_redo
    assert told[0].startswith("Undone")
    assert told[-1] == "Redone."


def test_a_new_change_forgets_what_was_undone_and_a_failed_one_is_none(files):
    put(files, "a.txt", "one")
    files.undo()
    put(files, "b.txt", "other")
    assert not files.can_redo
    with pytest.raises(ConfigError), files.changing("b.txt"):
        raise ConfigError("name", "b", "cannot be removed")
    files.undo()
    assert "b.txt" not in files.names
    assert not files.can_undo


def test_what_another_program_has_written_since_is_left_alone(files, tmp_path):
    put(files, "a.txt", "one")
    (tmp_path / "a.txt").write_text("theirs")
    with pytest.raises(ConfigError, match="was changed by another program"):
        files.undo()
    assert held(tmp_path) == {"a.txt": "theirs"}
    assert not files.can_undo


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


def test_a_pose_can_be_renamed_and_deleted_and_without_one_there_is_nothing_to_use(poses, page):
    poses.name = "mine"
    poses.save_arm()
    poses.name = "<b>other</b>"
    poses.rename()
    assert names(poses) == ["<b>other</b>"]
    assert poses.chosen == "<b>other</b>"
    poses.delete()
    assert names(poses) == []
    poses.choose("home")
    assert poses.chosen is None
    for command in (poses.use, poses.rename, poses.delete):
        with pytest.raises(ConfigError, match="save a pose first"):
            command()
    assert page.sentence[-1] == "Deleted <b>other</b>."
    poses.saved_files.undo()
    assert names(poses) == ["<b>other</b>"]
    assert poses.chosen == "<b>other</b>"
    poses.saved_files.undo()
    assert names(poses) == ["mine"]
    poses.name = "mine"
    poses.save_target()  # in its place
    poses.saved_files.undo()
    poses.use()
    np.testing.assert_allclose(page.aimed[-1], 0.1, atol=1e-6)


def test_a_broken_file_is_reported_and_the_page_opens_all_the_same(tmp_path, page):
    (tmp_path / "poses.json").write_text("{")
    poses = PoseList(SavedPoses(tmp_path / "poses.json"), page)
    assert poses.poses == ()
    assert "is not JSON" in page.sentence[0]
