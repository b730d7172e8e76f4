"""Read the JPEG pictures of a camera on this computer: a device such as ``/dev/video0`` of Linux.

Linux's video interface (V4L2, "Streaming I/O, memory mapping" in the kernel's documentation): a
picture size is agreed, the driver lends some buffers of its memory, fills one after the other, and
gets each back once it was read. Numbers and layouts are those of ``linux/videodev2.h``.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import select
import struct
from collections.abc import Callable, Generator

Ioctl = Callable[[int, int, bytearray], int]
Pictures = Generator[bytes, None, None]

WIDTH, HEIGHT = 640, 480
"""The size that is asked for [px], which most cameras have; chosen: the panel is 240 wide."""

BUFFERS = 3
"""How many buffers the driver fills in turn; chosen: one is read, one is filled, one waits."""

_CAPTURE, _MAPPED = 1, 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE, V4L2_MEMORY_MMAP
_BROKEN = 0x40  # V4L2_BUF_FLAG_ERROR
_JPEG = (b"MJPG", b"JPEG")

_FORMAT = struct.Struct("@I0L2I4s9I152x")  # type; width, height, pixels, what else it agrees to
_REQUEST = struct.Struct("@5I")  # count, type, memory, and two that are kept free
_BUFFER = struct.Struct("@5I2l16s2IL2Ii0l")
_INDEX, _USED, _FLAGS, _OFFSET, _LENGTH = 0, 2, 3, 10, 11  # of the numbers in a buffer
_TYPE = struct.Struct("@I")


def _code(direction: int, number: int, layout: struct.Struct) -> int:
    """The number of a request: written to the driver 1, read 2, both 3."""
    return direction << 30 | layout.size << 16 | ord("V") << 8 | number


_SET_FORMAT = _code(3, 5, _FORMAT)
_ASK_FOR_BUFFERS = _code(3, 8, _REQUEST)
_WHERE, _FILL, _TAKE = (_code(3, number, _BUFFER) for number in (9, 15, 17))
_START = _code(1, 18, _TYPE)

_REASONS = {
    errno.ENOENT: "is not there; plug it in",
    errno.ENODEV: "was unplugged",
    errno.EACCES: "is closed to you; join its group (sudo usermod -aG video $USER), log in again",
    errno.EBUSY: "is used by another program",
    errno.ENOTTY: "is no camera",
    errno.EINVAL: "takes no pictures; a camera often has a second device, try the other one",
}


def pictures(path: str, patience: float, ioctl: Ioctl = fcntl.ioctl) -> Pictures:
    """The pictures of a camera as they come, until the generator is closed.

    Args:
        path: The device.
        patience: How long to wait for a picture [s].
        ioctl: Asks the driver; changes the bytes it is given.

    Raises:
        OSError: There is no such camera, it cannot be read, or it sends nothing; the message says
            so and what to do.
    """
    try:
        device = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        try:
            yield from _stream(device, path, patience, ioctl)
        finally:
            os.close(device)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(f"{path} {_REASONS.get(error.errno, error.strerror)}") from error


def _stream(device: int, path: str, patience: float, ioctl: Ioctl) -> Pictures:
    wanted = bytearray(_FORMAT.pack(_CAPTURE, WIDTH, HEIGHT, _JPEG[0], *[0] * 9))
    ioctl(device, _SET_FORMAT, wanted)
    if _FORMAT.unpack(wanted)[3] not in _JPEG:
        raise OSError(
            f"{path} has no JPEG pictures; have another program send them,"
            f" such as ustreamer --device {path} --port 8090"
        )
    request = bytearray(_REQUEST.pack(BUFFERS, _CAPTURE, _MAPPED, 0, 0))
    ioctl(device, _ASK_FOR_BUFFERS, request)
    memory: list[mmap.mmap] = []
    try:
        for index in range(_REQUEST.unpack(request)[0]):
            buffer = _buffer(index)
            ioctl(device, _WHERE, buffer)
            reply = _BUFFER.unpack(buffer)
            memory.append(mmap.mmap(device, reply[_LENGTH], offset=reply[_OFFSET]))
            ioctl(device, _FILL, buffer)
        ioctl(device, _START, bytearray(_TYPE.pack(_CAPTURE)))
        while True:
            if not select.select([device], [], [], patience)[0]:
                raise OSError(f"{path} sends no picture")
            buffer = _buffer(0)
            ioctl(device, _TAKE, buffer)
            reply = _BUFFER.unpack(buffer)
            picture = memory[reply[_INDEX]][: reply[_USED]]
            ioctl(device, _FILL, buffer)
            if picture[:2] == b"\xff\xd8" and not reply[_FLAGS] & _BROKEN:  # the first often is not
                yield picture
    finally:  # the driver stops when the device is closed
        for each in memory:
            each.close()


def _buffer(index: int) -> bytearray:
    numbers = [0] * 8
    return bytearray(_BUFFER.pack(index, _CAPTURE, *numbers[:5], bytes(16), 0, _MAPPED, *[0] * 4))
