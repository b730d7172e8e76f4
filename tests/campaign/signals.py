"""Signals at random instants to verbs of the command line, on simulated and on emulated arms.

Each verb is a process. At a random time after its first instruction it gets a signal, or three
within 0.2 s. Laws: its exit code is 130; its last sentence, and no other, tells by what it was
ended and how it leaves the arm; for the emulated servos that is true, and they are at rest.
"""

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.pty_port import Pacing
from so101_motion.tasks.guided import files as guided_files
from so101_motion.tasks.guided.path import GuidedPath

LISTENS = """
from so101_motion import cli
listen = cli.interrupts.listen
def and_tell(*ends):
    listen(*ends)
    print(flush=True)
cli.interrupts.listen = and_tell
cli.main()
"""
HEARS = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
    "signal.signal(signal.SIGHUP, signal.SIG_DFL);"
)
"""A test runner in the background ignores one or both, and so would its children."""

KINDS = (["SIGINT"], ["SIGINT"] * 3, ["SIGTERM"], ["SIGHUP"], ["SIGTERM", "SIGINT", "SIGHUP"])
WITHIN = 0.2  # [s], in which three signals come
PATIENCE = 90.0  # [s] for the end of a verb, on a busy machine

FREE, PORT = ("--sim",), ("--port", "{port}")
MOVES = {
    "move": ("move", "--pose", "{pose}", "--yes"),
    "view": ("view", "--no-browser"),
    "run": ("run", "{program}", "--yes"),
    "replay": ("guide", "replay", "{path}", "--yes"),
    "move-test": ("move-test", "--yes"),
    "record": ("guide", "record", "{folder}/{seed}.json", "--yes"),
    "plan": ("plan", "--pose", "{pose}"),
    "status": ("status",),
}
VERBS = {
    **{f"{name}, simulated": (*words, *FREE) for name, words in MOVES.items()},
    **{f"{name}, emulated": (*words, *PORT) for name, words in MOVES.items()},
    "demo": ("demo", "--no-browser"),
    "doctor": ("doctor", *PORT),
    "identify": ("identify", "--yes", *PORT),
    "report-arm": ("report-arm", "{folder}/r{seed}.json", "--yes", *PORT),
    "emulate": ("emulate", "--realtime", "--link", "{folder}/other"),
    "calibrate": ("calibrate", "--yes", *PORT),
    "setup": ("setup", "--yes", "--start-over", *PORT),
    "setup in the browser": ("setup", "--web", "--no-browser", *PORT),
    "setup in the browser, no port": ("setup", "--web", "--no-browser"),
    "teleop": ("teleop", "--leader", "sim", "--follower", "{port}", "--yes"),
}


class Bench:
    """An emulated arm, and files for the verbs."""

    def __init__(self, folder):
        self.folder = Path(folder)
        options = EmulatorOptions(link=self.folder / "arm", pacing=Pacing(realtime=True))
        self._emulator = Emulator(options)
        self.world = self._emulator.world
        q_deg = [[0, 0, 0, 0, 0], [40, -20, 20, 10, 30]]
        waypoints = [{"q_deg": q, "name": str(k)} for k, q in enumerate(q_deg)]
        program = {"schema": "so101/program/1", "rounds": 9, "waypoints": waypoints}
        (self.folder / "program.json").write_text(json.dumps(program))
        path = GuidedPath(t=np.array([0.0, 3.0]), q=np.radians(q_deg))
        guided_files.write(path, self.folder / "path.json")

        begin = time.monotonic()  # by then all verbs move, however busy this machine is
        subprocess.run(
            [sys.executable, "-c", "from so101_motion.cli import main; main()", "move", *FREE,
             "--pose", "ready", "--yes"], check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        self.span = time.monotonic() - begin

    def close(self):
        self._emulator.close()

    def words(self, verb, seed, rng):
        places = {
            "port": self.folder / "arm", "folder": self.folder, "path": self.folder / "path.json",
            "program": self.folder / "program.json", "pose": rng.choice(["home", "ready", "rest"]),
            "seed": seed,
        }  # fmt: skip
        return [each.format(**places) for each in VERBS[verb]]

    def servos(self):
        """Their torque, and where they are [deg]."""
        self._emulator.advance()
        torque = [bool(servo.drive.torque) for servo in self.world.servos]
        return torque, np.degrees(self.world.q)


def end(bench, verb, seed):
    """Start a verb and end it by signals; what is wrong about its end."""
    rng = random.Random(seed)
    kind, after = rng.choice(KINDS), rng.uniform(0.0, bench.span)
    _, q_before = bench.servos()
    command = [sys.executable, "-c", HEARS + LISTENS, *bench.words(verb, seed, rng)]
    env = {**os.environ, "XDG_DATA_HOME": str(bench.folder), "SO101_PORT": ""}
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, env=env, **pipes) as process:
        process.stdout.readline()
        time.sleep(after)
        is_over = process.poll() is not None  # such as by a computer that stood still
        for name in kind:
            process.send_signal(getattr(signal, name))
            time.sleep(rng.uniform(0.0, WITHIN / 2.0) if kind[1:] else 0.0)
        try:
            said = process.communicate(timeout=PATIENCE)[1].decode()
        except BaseException as error:  # the time of the test may be over, too
            process.kill()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            return [f"did not end within {PATIENCE:g} s"]
    *others, last = said.splitlines() or [""]
    if is_over or (process.returncode == 0 and not last.startswith("ended")):
        return []  # it was over before the signal
    wrong = [] if process.returncode == 130 else [f"exit code {process.returncode}"]
    if (
        not last.startswith("ended by ")
        or "Interrupt" in last
        or any("ended" in line for line in others)
    ):
        wrong.append("not one sentence")
    if "Traceback" in said:
        wrong.append("a traceback")
    wrong += _lies(bench, last, q_before) if "simulated" not in verb and verb != "demo" else []
    return [f"{each}: {kind} after {after:.3f} s: {said[-600:]!r}" for each in wrong]


def _lies(bench, last, q_before):
    torque, q = bench.servos()
    time.sleep(0.1)
    _, later = bench.servos()
    wrong = ["still moves"] if np.max(np.abs(later - q)) > 1.0 else []
    if "nothing moved" in last and np.max(np.abs(q - q_before)) > 1.0:
        wrong.append("it moved")
    if f"{bench.folder}/arm holds" in last and not all(torque):
        wrong.append("it does not hold")
    if "held where" in last and not any(torque):
        wrong.append("nothing is held")
    if "limp" in last and any(torque):
        wrong.append("it is held")
    if "no motor answers" in last:
        wrong.append("they answer")
    return wrong


def run(seed, *, count):
    """Send a signal to each of ``count`` verbs; what was wrong."""
    verbs = random.Random(seed).sample(sorted(VERBS), count)
    with tempfile.TemporaryDirectory() as folder, closing(Bench(folder)) as bench:
        return [f"{verb}: {text}" for verb in verbs for text in end(bench, verb, f"{seed}-{verb}")]
