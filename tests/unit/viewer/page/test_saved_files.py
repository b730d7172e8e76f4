import pytest
from so101_viewer.page.history import SavedFiles

from so101_motion.common.errors import ConfigError


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


def test_files_of_other_programs_are_seen_a_second_later_and_the_folder_is_read_no_oftener(
    files, tmp_path
):
    files.look_again(10.0)
    (tmp_path / "theirs.txt").write_text("made elsewhere")
    files.look_again(10.9)
    assert files.names == ()
    files.look_again(11.0)
    assert files.names == ("theirs.txt",)
    (tmp_path / "theirs.txt").unlink()
    files.look_again(12.0)
    assert files.names == ()
