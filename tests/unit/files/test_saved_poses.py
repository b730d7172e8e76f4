import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.common.errors import ConfigError
from so101_motion.common.named_poses import POSES
from so101_motion.files import user_storage
from so101_motion.files.saved_poses import MOST, SavedPoses

KIND = '{"schema": "so101/poses/1"'
Q = np.radians([10.0, -40.0, 35.0, 60.0, 0.0])


@pytest.fixture
def book(tmp_path):
    return SavedPoses(tmp_path / "new folder" / "poses.json")


def test_there_are_the_poses_of_the_arm_and_a_saved_one_is_found_by_another_reader(book, tmp_path):
    assert book.own() == ()
    assert book.find("rest") is next(pose for pose in POSES if pose.name == "rest")
    book.save("  over the mug ", Q)
    found = SavedPoses(tmp_path / "new folder" / "poses.json").find("over the mug")
    np.testing.assert_allclose(found.q, Q, atol=1e-6)


def test_saving_under_the_same_name_replaces_in_place_and_a_pose_is_renamed_and_deleted(book):
    book.save("a", Q)
    book.save("b", Q)
    book.save("a", 2.0 * Q)
    assert [pose.name for pose in book.own()] == ["a", "b"]
    np.testing.assert_allclose(book.find("a").q, 2.0 * Q, atol=1e-6)
    book.rename("a", "c")
    assert [pose.name for pose in book.own()] == ["c", "b"]
    book.delete("c")
    assert [pose.name for pose in book.own()] == ["b"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("", "type a name first"),
        ("   ", "type a name first"),
        ("x" * 41, "longer than 40"),
        ("a\nb", "cannot be shown"),
        ("Home", "is built in"),
    ],
)
def test_names_that_cannot_be_used_are_refused_and_nothing_is_written(book, name, reason):
    with pytest.raises(ConfigError, match=reason):
        book.save(name, Q)
    assert book.own() == ()


def test_what_is_not_there_cannot_be_renamed_deleted_or_found(book):
    book.save("mug", Q)
    book.save("cup", Q)
    with pytest.raises(ConfigError, match="is taken"):
        book.rename("mug", "cup")
    with pytest.raises(ConfigError, match="not one of your own"):
        book.rename("home", "house")
    with pytest.raises(ConfigError, match="not one of your own"):
        book.delete("rest")
    with pytest.raises(ConfigError, match='did you mean "mug"'):
        book.find("mugg")


def test_there_is_an_end_to_how_many_there_may_be(book, tmp_path):
    poses = [{"name": f"p{k}", "q_deg": [0, 0, 0, 0, 0]} for k in range(MOST)]
    (tmp_path / "new folder").mkdir()
    file = tmp_path / "new folder" / "poses.json"
    file.write_text(json.dumps({"schema": "so101/poses/1", "poses": poses}))
    with pytest.raises(ConfigError, match="delete some first"):
        book.save("one more", Q)
    assert len(book.own()) == MOST


@pytest.mark.parametrize(
    ("text", "reason"),
    [("[", "is not JSON"), (KIND + ', "poses": [], "poses": []}', "has poses twice")],
)
def test_a_broken_file_says_what_is_wrong_and_is_left_alone(tmp_path, text, reason):
    file = tmp_path / "poses.json"
    file.write_text(text)
    book = SavedPoses(file)
    for use in (book.own, lambda: book.save("mine", Q)):
        with pytest.raises(ConfigError, match=reason):
            use()
    assert file.read_text() == text


def test_the_file_of_the_user_is_in_the_data_directory(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    SavedPoses().save("mine", Q)
    assert (tmp_path / "so101_motion" / "poses.json").is_file()


@given(st.lists(st.floats(-180.0, 180.0), min_size=5, max_size=5))
def test_joint_angles_survive_being_written(q_deg):
    q = np.radians(q_deg)
    written = user_storage.joints_to_deg(q)
    np.testing.assert_allclose(user_storage.joints_from_deg(written, key="q"), q, atol=1e-6)
    assert user_storage.joints_to_deg(user_storage.joints_from_deg(written, key="q")) == written


@pytest.mark.parametrize("name", ["con", "CON .", "nul.json", "com1", "wave.", "wave "])
def test_names_that_windows_takes_for_something_else_are_refused_and_no_others(name):
    with pytest.raises(ConfigError, match="Windows"):
        user_storage.refuse_reserved(name, what="name")
    for taken in ("console", "wave 1.2", "nullify", "com", ".hidden"):
        user_storage.refuse_reserved(taken, what="name")
