"""Pictures from a camera device, with an emulated driver."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest
from harness.video_driver import BROKEN, VideoDriver
from harness.web_camera import jpeg
from so101_viewer.page.video_device import pictures


def test_pictures_come_whole_and_in_turn_until_it_is_unplugged(tmp_path: Path) -> None:
    file, sent = tmp_path / "video0", [jpeg(k) for k in range(5)]
    driver = VideoDriver(file, [b"", sent[0], BROKEN, *sent[1:]])
    stream = pictures(str(file), 1.0, driver.ioctl)
    assert [next(stream) for _ in sent] == sent
    assert len(driver.lent) == 2  # every buffer went back
    with pytest.raises(OSError, match="video0 was unplugged"):
        next(stream)


def test_a_camera_without_jpeg_is_told_another_way(tmp_path: Path) -> None:
    driver = VideoDriver(tmp_path / "video0", pixels=b"YUYV")
    with pytest.raises(OSError, match=r"has no JPEG pictures; .*ustreamer --device"):
        next(pictures(str(driver.file), 1.0, driver.ioctl))


@pytest.mark.parametrize(
    ("path", "says"),
    [("/dev/null", "/dev/null is no camera"), ("/dev/video-none", "is not there; plug it in")],
)
def test_a_file_that_is_no_camera_is_reported(path: str, says: str) -> None:
    with pytest.raises(OSError, match=says):
        next(pictures(path, 1.0))


def test_a_camera_that_this_user_may_not_open_says_how_to_get_access(tmp_path: Path) -> None:
    def refuse(_device: int, _request: int, _told: bytearray) -> int:
        raise PermissionError(errno.EACCES, "Permission denied")

    with pytest.raises(OSError, match=r"is closed to you; join its group .*usermod -aG video"):
        next(pictures(str(VideoDriver(tmp_path / "video0").file), 1.0, refuse))
