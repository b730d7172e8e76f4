#!/bin/sh
# feetech-servo-sdk 1.0.0: GroupSyncRead with three servos, of which the first falls silent. Needs a Unix terminal.
#
# Expected: isAvailable(id) tells whether this reading brought an answer of that servo.
# Seen: reading ends at the first servo that is silent, and the answers of those behind it stay in the port's buffer.
# For these isAvailable() is still True, and getData() gives what the reading before had brought: joints that move seem to
# stand. Only the return value of txRxPacket tells, and it tells not of whom; for the silent servo itself getData() is 0,
# which is a valid position.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet feetech-servo-sdk==1.0.0 pyserial==3.5
"$folder/venv/bin/python" - <<'PY'
import os
import pty
import threading
import tty

import scservo_sdk as sdk

SYNC_READ, PRESENT_POSITION = 0x82, 56
ours, theirs = pty.openpty()
tty.setraw(ours)
tty.setraw(theirs)
positions, answering = {1: 100, 2: 200, 3: 300}, {1, 2, 3}


def servos():
    heard = b""
    while True:
        heard += os.read(ours, 256)
        while len(heard) >= 4 and len(heard) >= heard[3] + 4:
            packet, heard = heard[: heard[3] + 4], heard[heard[3] + 4 :]
            for servo in packet[7:-1] if packet[4] == SYNC_READ else ():
                if servo in answering:
                    body = bytes([servo, 4, 0]) + positions[servo].to_bytes(2, "little")
                    os.write(ours, b"\xff\xff" + body + bytes([~sum(body) & 255]))


threading.Thread(target=servos, daemon=True).start()
port = sdk.PortHandler(os.ttyname(theirs))
assert port.openPort() and port.setBaudRate(1_000_000)
group = sdk.GroupSyncRead(port, sdk.PacketHandler(0), PRESENT_POSITION, 2)
for servo in positions:
    group.addParam(servo)


def reading():
    result = group.txRxPacket()
    found = {i: (group.isAvailable(i, PRESENT_POSITION, 2), group.getData(i, PRESENT_POSITION, 2)) for i in positions}
    print(f"servos at {positions}, answering {sorted(answering)}: result {result}, (available, position) {found}")
    return result, found


assert reading() == (0, {1: (True, 100), 2: (True, 200), 3: (True, 300)})
answering.discard(1)
positions = {i: at + 1000 for i, at in positions.items()}
result, found = reading()
assert result != 0 and found == {1: (False, 0), 2: (True, 200), 3: (True, 300)}
PY
