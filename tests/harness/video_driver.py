"""The driver of a camera device (V4L2), emulated: its memory is a file."""

from __future__ import annotations

import errno
import os
import struct
import threading
from collections.abc import Iterable
from pathlib import Path

PAGE = os.sysconf("SC_PAGE_SIZE")
FORMAT, ASK, WHERE, FILL, TAKE, START = (
    0xC0D05605, 0xC0145608, 0xC0585609, 0xC058560F, 0xC0585611, 0x40045612
)  # fmt: skip  # of 64-bit Linux
BROKEN = b"broken"


class VideoDriver:
    """Fills two buffers in turn; unplugged when it has no more pictures.

    Args:
        file: Its memory, and the device.
        frames: The pictures.
        pixels: Their format.
        period: How long each takes [s].
    """

    def __init__(
        self,
        file: Path,
        frames: Iterable[bytes] = (),
        *,
        pixels: bytes = b"MJPG",
        period: float = 0.0,
    ) -> None:
        self.file, self.frames, self.pixels = file, iter(frames), pixels
        self._period = period
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
        threading.Event().wait(self._period)
        frame = next(self.frames, None)
        if frame is None:
            raise OSError(errno.ENODEV, "No such device")
        index = self.lent.pop(0)
        os.pwrite(device, frame.ljust(PAGE, b"?"), index * PAGE)
        struct.pack_into("I", told, 0, index)
        struct.pack_into("I", told, 8, len(frame))
        struct.pack_into("I", told, 12, 0x40 if frame == BROKEN else 0)
