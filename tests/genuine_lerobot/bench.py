"""Emulated arms as processes, and LeRobot's commands run against them."""

import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.port.serial_port import SerialPort

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent


class Failure(Exception):
    pass


class Bench:
    """Emulated arms, and LeRobot's commands with a home of their own."""

    patience = 1.0  # on a busy machine everything takes longer

    def __init__(self, folder, priority):
        self.folder, self.priority = folder, priority
        self.env = os.environ | {
            "HF_HOME": str(folder / "hf"),
            "HF_LEROBOT_HOME": str(folder / "lerobot"),
            "HF_HUB_OFFLINE": "1",
        }

    @contextmanager
    def arm(self, name, *options):
        port = self.folder / name
        command = [*self.priority, str(BIN / "so101"), "emulate", "--link", str(port), *options]
        emulator = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
        )
        try:
            self.until(port.exists, "the emulator")
            time.sleep(1.0)
            for file in self.folder.glob(f"lerobot/calibration/*/*/{name}.json"):
                # New servos stand for those that were calibrated before.
                write = ("calibration", "write", "--yes", "--port", str(port), str(file))
                subprocess.run([str(BIN / "so101"), *write], check=True, capture_output=True)
            yield Arm(port, emulator)
        finally:
            emulator.terminate()
            emulator.wait(10)

    def begin(self, command, *arguments, stdin=subprocess.PIPE):
        return Command(
            subprocess.Popen(
                [str(BIN / f"lerobot-{command}"), *map(str, arguments)],
                env=self.env,
                cwd=self.folder,
                stdin=stdin,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        )

    def run(self, command, *arguments, within=90.0):
        running = self.begin(command, *arguments)
        running.end(within)
        return running

    @staticmethod
    def until(is_so, what, within=30.0):
        end = time.monotonic() + within * Bench.patience
        while not is_so():
            if time.monotonic() > end:
                raise Failure(f"{what} did not come within {within:g} s")
            time.sleep(0.05)


class Arm:
    """An emulated arm; what people do to it can be typed."""

    def __init__(self, port, emulator):
        self.port, self._emulator = port, emulator

    def type(self, text):
        self._emulator.stdin.write(text + "\n")
        self._emulator.stdin.flush()

    def degrees(self):
        bus = Bus(SerialPort(str(self.port)))
        try:
            ticks = [bus.read(i, reg.PRESENT_POSITION) for i in range(1, 7)]
        finally:
            bus.close()
        return np.array(ticks) * 360.0 / 4096.0

    def dropped(self):
        """How far its joints move within three seconds in which nobody has the port [deg]."""
        here = self.degrees()
        time.sleep(3.0)
        return float(np.abs(self.degrees() - here).max())


class Command:
    """One of LeRobot's commands, running; what it says is kept."""

    def __init__(self, process):
        self._process, self.said = process, ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        while text := self._process.stdout.read(1):
            self.said += text

    def await_text(self, text, within=60.0):
        def is_there():
            return text in self.said or self._process.poll() is not None

        Bench.until(is_there, text, within)
        if text not in self.said:
            raise Failure(f"it ended before it said {text!r}: {self.said[-600:]}")

    def enter(self, text=""):
        self._process.stdin.write(text + "\n")
        self._process.stdin.flush()

    def send(self, number):
        self._process.send_signal(number)

    def end(self, within, code=0):
        """Wait for its end; how long that took [s]."""
        begin = time.monotonic()
        try:
            ended = self._process.wait(within * Bench.patience)
        except subprocess.TimeoutExpired:
            self._process.kill()
            raise Failure(f"it did not end within {within:g} s: {self.said[-600:]}") from None
        self._reader.join(5.0)
        if code is not None and ended != code:
            raise Failure(f"it ended with {ended}, not {code}: {self.said[-900:]}")
        return time.monotonic() - begin
