import json
import os
import sys

import pytest
from so101_viewer.server.kept_key import LIFETIME, key_for, new_key

PAGE = "Arm on /dev/ttyACM0"


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return tmp_path / "so101_motion" / "page-keys.json"


def test_a_page_has_the_same_key_when_it_is_started_again(file):
    key = key_for(PAGE, 8080)
    assert key_for(PAGE, 8080) == key
    assert len(key) == len(new_key()) >= 43
    assert len({key, key_for(PAGE, 8081), key_for("Simulated arm", 8080)}) == 3
    assert key_for(PAGE, 8080) == key


def test_a_new_key_makes_the_old_one_invalid(file):
    key = key_for(PAGE, 8080)
    new = key_for(PAGE, 8080, is_new=True)
    assert new != key
    assert key_for(PAGE, 8080) == new


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such permissions")
def test_keys_that_others_could_have_read_are_not_used_again(file):
    key = key_for(PAGE, 8080)
    assert file.stat().st_mode & 0o077 == 0
    os.chmod(file, 0o644)
    assert key_for(PAGE, 8080) != key
    assert file.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    ("key", "age"),
    [("short", 0.0), (None, 0.0), ("ü" * 43, 0.0), ("k" * 43, LIFETIME + 60.0), ("k" * 43, -60.0)],
)
def test_a_key_that_is_old_or_no_key_is_replaced(file, key, age):
    key_for(PAGE, 8080)
    content = json.loads(file.read_text())
    (entry,) = content["keys"].values()
    entry["key"], entry["made_at"] = key, int(entry["made_at"] - age)
    file.write_text(json.dumps(content))
    new = key_for(PAGE, 8080)
    assert new not in (key, None)
    file.write_text("{")
    assert key_for(PAGE, 8080) != new


def test_without_a_folder_for_files_there_is_a_key_all_the_same(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "file"))
    assert len(key_for(PAGE, 8080)) >= 43
