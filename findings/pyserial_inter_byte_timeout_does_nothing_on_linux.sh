#!/bin/sh
# pyserial 3.5: Serial(timeout=..., inter_byte_timeout=...). Needs Linux or another Unix.
#
# Expected: read(100) of a reply of 8 bytes ends when nothing has followed for inter_byte_timeout (20 ms); that is
# what it is for where the length of a reply is not known.
# Seen: it is accepted, stored and set in the terminal's VTIME, but read() waits with select() until it has all bytes or
# until timeout: 0.5 s, as without it. A bus of servos that is polled in this way runs at 2 Hz.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyserial==3.5
"$folder/venv/bin/python" - <<'PY'
import os
import pty
import threading
import time
import tty

import serial

ours, theirs = pty.openpty()
tty.setraw(ours)
tty.setraw(theirs)


def took(**more):
    """How long a read of 100 bytes lasts when 8 come at once, [s]."""
    with serial.Serial(os.ttyname(theirs), 1_000_000, timeout=0.5, **more) as port:
        threading.Timer(0.05, os.write, (ours, b"\xff\xff\x01\x04\x00\x20\x08\xd2")).start()
        begin = time.monotonic()
        assert len(port.read(100)) == 8
        return time.monotonic() - begin


alone, both = took(), took(inter_byte_timeout=0.02)
print(f"timeout 0.5 s: {alone:.2f} s; with an inter_byte_timeout of 0.02 s: {both:.2f} s (0.07 s would be right)")
assert alone >= 0.49 and both >= 0.49
PY
