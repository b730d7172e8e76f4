import os
import pathlib
import sys
import threading

import pytest

from so101_motion.files import atomic


@pytest.mark.skipif(sys.platform != "linux", reason="asks /proc what is open")
def test_what_is_written_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    file = tmp_path / "arm.json"
    file.write_text("old")
    seen = []

    def fsync(opened):
        what = "folder" if os.path.isdir(f"/proc/self/fd/{opened}") else "file"
        seen.append((what, file.read_text()))

    monkeypatch.setattr(os, "fsync", fsync)
    atomic.write(file, b"new")

    assert seen == [("file", "old"), ("folder", "new")]
    assert os.listdir(tmp_path) == ["arm.json"]


def test_one_writer_at_a_time_and_the_next_one_right_after(tmp_path):
    inside, order = threading.Event(), []

    def second():
        inside.wait()
        with atomic.locked(tmp_path):
            order.append("second")

    thread = threading.Thread(target=second, name="so101-second")
    thread.start()
    with atomic.locked(tmp_path):
        inside.set()
        thread.join(0.05)
        order.append("first")
    thread.join()

    assert order == ["first", "second"]


def test_leftovers_of_a_killed_writer_are_removed_by_the_next(tmp_path):
    abandoned, fresh, foreign = (
        tmp_path / name for name in (".mug.json.123-456.tmp", ".cup.json.123-456.tmp", ".x.tmp")
    )
    for each in (abandoned, fresh, foreign):
        each.write_text("half of")
    os.utime(abandoned, (1.0, 1.0))
    os.utime(foreign, (1.0, 1.0))
    atomic.write(tmp_path / "other.json", b"whole")
    assert sorted(os.listdir(tmp_path)) == [fresh.name, foreign.name, "other.json"]


@pytest.mark.skipif(sys.platform == "win32", reason="links and permissions are others there")
def test_what_a_link_points_to_is_written_and_keeps_its_permissions(tmp_path):
    file, link = tmp_path / "file.json", tmp_path / "link.json"
    file.write_text("old")
    file.chmod(0o600)
    link.symlink_to(file)
    atomic.write(link, b"new")
    assert link.is_symlink()
    assert file.read_text() == "new"
    assert file.stat().st_mode & 0o777 == 0o600


@pytest.mark.skipif(sys.platform == "win32", reason="has no such device")
def test_a_device_is_written_to_and_not_replaced():
    atomic.write(pathlib.Path("/dev/null"), b"gone")
    assert pathlib.Path("/dev/null").is_char_device()
