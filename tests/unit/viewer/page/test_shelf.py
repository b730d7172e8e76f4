from __future__ import annotations

from pathlib import Path

import pytest
from so101_viewer.page.shelf import Shelf

from so101_motion.common.errors import ConfigError


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def shelf(tmp_path: Path, told: list[str]) -> Shelf:
    return Shelf(
        lambda name: tmp_path / name,
        lambda: tuple(sorted(file.name for file in tmp_path.iterdir() if file.suffix != ".lock")),
        lambda sentence: told.append(sentence.text),
    )


def put(shelf: Shelf, name: str, text: str) -> None:
    with shelf.changing(name) as file:
        file.write_text(text)


def held(folder: Path) -> dict[str, str]:
    return {file.name: file.read_text() for file in folder.iterdir() if file.suffix == ".txt"}


def test_what_was_written_over_and_deleted_comes_back_in_turn(
    shelf: Shelf, told: list[str], tmp_path: Path
) -> None:
    put(shelf, "a.txt", "one")
    put(shelf, "a.txt", "two")
    with shelf.changing("a.txt") as file:
        file.unlink()
    stages = [{"a.txt": "two"}, {"a.txt": "one"}, {}]
    for stage in stages:
        assert shelf.can_undo
        shelf.undo()
        assert held(tmp_path) == stage
        assert ("a.txt" in shelf.names) is bool(stage)
    assert not shelf.can_undo
    shelf.undo()
    for stage in ({"a.txt": "one"}, {"a.txt": "two"}, {}):
        shelf.redo()
        assert held(tmp_path) == stage
    assert not shelf.can_redo
    assert told[0].startswith("Undone")
    assert told[-1] == "Redone."


def test_a_new_change_forgets_what_was_undone_and_a_failed_one_is_none(shelf: Shelf) -> None:
    put(shelf, "a.txt", "one")
    shelf.undo()
    put(shelf, "b.txt", "other")
    assert not shelf.can_redo
    with pytest.raises(ConfigError), shelf.changing("b.txt"):
        raise ConfigError("name", "b", "cannot be removed")
    shelf.undo()
    assert "b.txt" not in shelf.names
    assert not shelf.can_undo


def test_what_another_program_has_written_since_is_left_alone(shelf: Shelf, tmp_path: Path) -> None:
    put(shelf, "a.txt", "one")
    (tmp_path / "a.txt").write_text("theirs")
    with pytest.raises(ConfigError, match="was changed by another program"):
        shelf.undo()
    assert held(tmp_path) == {"a.txt": "theirs"}
    assert not shelf.can_undo
