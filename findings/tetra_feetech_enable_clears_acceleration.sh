#!/bin/sh
# tetra-feetech 0.1.0 on feetech-servo-sdk 1.0.0: Client.enable(), disable(), enabled().
#
# Expected: enable() writes the torque switch (register 40), enabled() tells its state.
# Seen: the register is taken for two bytes wide, so enable() and disable() also write 0 into register 41,
# the acceleration, and 0 is "as fast as the servo can": a servo that was given a gentle acceleration
# moves at its hardest after the first enable(). And enabled() says False for a servo that is on, as
# soon as its acceleration is set again. read_load_percent() takes the sign bit (1024) for 1000: a
# load of -10.0 % reads as +12.4 %.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet tetra-feetech==0.1.0 feetech-servo-sdk==1.0.0 pyserial==3.5
"$folder/venv/bin/python" - <<'PY'
import os
import pty
import threading
import tty

from feetech import Client


class Servo:
    """A servo with id 1 behind a pseudo-terminal: memory that is read and written."""

    def __init__(self):
        self._line, end = pty.openpty()
        tty.setraw(self._line), tty.setraw(end)
        self.port, self.memory = os.ttyname(end), bytearray(80)
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        waiting = b""
        while True:
            waiting += os.read(self._line, 256)
            while len(waiting) >= 4 and len(waiting) >= 4 + waiting[3]:
                size = 4 + waiting[3]
                kind, data, waiting = waiting[4], waiting[5 : size - 1], waiting[size:]
                answer = b""
                if kind == 3:
                    self.memory[data[0] : data[0] + len(data) - 1] = data[1:]
                elif kind == 2:
                    answer = bytes(self.memory[data[0] : data[0] + data[1]])
                body = bytes([1, len(answer) + 2, 0]) + answer
                os.write(self._line, b"\xff\xff" + body + bytes([~sum(body) & 255]))


servo = Servo()
servo.memory[41] = 20  # 2000 counts/s2
with Client(servo.port) as client:
    client.enable(1)
    after = servo.memory[41]
    servo.memory[41] = 20
    told = client.enabled(1)
    servo.memory[60:62] = (1024 + 100).to_bytes(2, "little")
    load = client.read_load_percent(1)
print(f"acceleration 20 -> {after}; torque register {servo.memory[40]}, enabled() {told}; load -0.100 reads {load}")
assert after == 0 and servo.memory[40] == 1 and told is False and load == 0.124
PY
