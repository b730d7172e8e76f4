"""Pictures from a camera device, with an emulated driver whose memory is a file."""

from __future__ import annotations

import errno
import os
import struct
from pathlib import Path

import pytest
from harness.web_camera import jpeg
from so101_viewer.page.video_device import pictures

PAGE = os.sysconf("SC_PAGE_SIZE")
FORMAT, ASK, WHERE, FILL, TAKE, START = (
    0xC0D05605, 0xC0145608, 0xC0585609, 0xC058560F, 0xC0585611, 0x40045612
)  # fmt: skip  # of 64-bit Linux
BROKEN = b"broken"


class Driver:
    """Fills two buffers in turn; unplugged when it has no more pictures."""

    def __init__(self, file: Path, *frames: bytes, pixels: bytes = b"MJPG") -> None:
        self.file, self.frames, self.pixels = file, list(frames), pixels
        self.lent, self.runs = list[int](), False
        file.write_bytes(bytes(2 * PAGE))

    def ioctl(self, device: int, request: int, told: bytearray) -> int:
        index = struct.unpack_from("I", told)[0]
        if request == FORMAT:
            told[16:20] = self.pixels
        elif request == ASK:
            self.lent, self.runs = [], False  # all were given back when it was closed
            struct.pack_into("I", told, 0, 2)
        elif request == WHERE:
            struct.pack_into("I", told, 0x40, index * PAGE)
            struct.pack_into("I", told, 0x48, PAGE)
        elif request == FILL:
            assert index not in self.lent
            self.lent.append(index)
        elif request == START:
            self.runs = True
        elif request == TAKE:
            assert self.runs
            self._fill(device, told)
        return 0

    def _fill(self, device: int, told: bytearray) -> None:
        if not self.frames:
            raise OSError(errno.ENODEV, "No such device")
        index, frame = self.lent.pop(0), self.frames.pop(0)
        os.pwrite(device, frame.ljust(PAGE, b"?"), index * PAGE)
        struct.pack_into("I", told, 0, index)
        struct.pack_into("I", told, 8, len(frame))
        struct.pack_into("I", told, 12, 0x40 if frame == BROKEN else 0)


def test_pictures_come_whole_and_in_turn_until_it_is_unplugged(tmp_path: Path) -> None:
    file, sent = tmp_path / "video0", [jpeg(k) for k in range(5)]
    driver = Driver(file, b"", sent[0], BROKEN, *sent[1:])
    stream = pictures(str(file), 1.0, driver.ioctl)
    assert [next(stream) for _ in sent] == sent
    assert len(driver.lent) == 2  # every buffer went back
    with pytest.raises(OSError, match="video0 was unplugged"):
        next(stream)


def test_a_camera_without_jpeg_is_told_another_way(tmp_path: Path) -> None:
    driver = Driver(tmp_path / "video0", pixels=b"YUYV")
    with pytest.raises(OSError, match=r"has no JPEG pictures; .*ustreamer --device"):
        next(pictures(str(driver.file), 1.0, driver.ioctl))


@pytest.mark.parametrize(
    ("path", "says"),
    [("/dev/null", "/dev/null is no camera"), ("/dev/video-none", "is not there; plug it in")],
)
def test_a_file_that_is_no_camera_is_reported(path: str, says: str) -> None:
    with pytest.raises(OSError, match=says):
        next(pictures(path, 1.0))
