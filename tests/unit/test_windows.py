"""The package as Windows' Python would find it (``harness/windows_like``). Nobody tried Windows."""

import os
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.pty_port import Pacing

ROOT = Path(__file__).parents[2]
LIKE_WINDOWS = ROOT / "tests" / "harness" / "windows_like"

CLI = "from so101_motion.cli import main; sys.exit(main())"
EVERY_MODULE = """
import importlib, pkgutil
for root in ("so101_motion", "so101_viewer", "so101_description", "lerobot_robot_so101_motion"):
    for found in pkgutil.walk_packages(importlib.import_module(root).__path__, root + "."):
        if "-" not in found.name and not found.name.endswith("__main__"):
            importlib.import_module(found.name)
print(len([name for name in sys.modules if name.startswith("so101_")]))
"""
A_MOVE = """
import so101_motion as so101
with so101.open("sim") as rig:
    rig.arm.move(rig.arm.plan(so101.point(0.25, 0.12, 0.15)))
    print(rig.arm.T_base_tool.p.round(3))
"""
A_LINE = """
import time
from so101_motion.drivers.port.serial_port import SerialPort
port = SerialPort(sys.argv[1])
port.write(bytes.fromhex("ffff010201fb"))
print(port.read(time.monotonic() + 60.0).hex(), port.read(0.0))
port.close()
"""


def on_windows(code, *arguments, hidden=""):
    """A process that our modules take for one of Windows; ``hidden`` packages are not there."""
    path = (LIKE_WINDOWS, ROOT, ROOT / "tests" / "recorded_types", *sys.path)
    environment = {"PYTHONPATH": os.pathsep.join(map(str, path)), "HIDDEN_PACKAGES": hidden}
    return subprocess.Popen(
        [sys.executable, "-c", f"import sys\n{code}", *arguments],
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def said(process):
    """What it said on stdout and on stderr."""
    with process:
        return process.communicate(timeout=100)


def test_every_module_can_be_imported():
    out, err = said(on_windows(EVERY_MODULE))
    assert not err
    assert int(out) > 400


def test_a_simulated_arm_plans_in_a_process_of_its_own_and_moves():
    assert said(on_windows(A_MOVE))[0] == "[0.25 0.12 0.15]\n"


def test_the_page_is_served_until_ctrl_c():
    with on_windows(CLI, "demo", "--no-browser") as demo:
        link = next(line.split()[1] for line in demo.stdout if "http://" in line)
        with urllib.request.urlopen(link, timeout=60) as page:
            assert page.status == 200
        demo.send_signal(signal.SIGINT)
        assert demo.wait(60) == 130
        assert demo.stderr.read().endswith("ended by Ctrl-C; the simulated arm holds\n")


def test_a_servo_on_a_port_answers():
    with Emulator(EmulatorOptions(pacing=Pacing())) as emulator:
        assert said(on_windows(A_LINE, emulator.port)) == ("ffff010200fc b''\n", "")


@pytest.mark.parametrize(
    ("verb", "hidden", "says"),
    [
        ("emulate", "", "needs a pseudo-terminal, and Windows has none\n  try: use WSL2"),
        ("status --sim", "coal pinocchio", "no package for Windows\n  try: WSL2; README.md"),
        ("status --port COM99", "", "there is no such port\n  try: check the USB cable"),
    ],
)
def test_what_does_not_work_is_told_with_what_to_do(verb, hidden, says):
    _, err = said(on_windows(CLI, *verb.split(), hidden=hidden))
    assert says in err
    assert "Traceback" not in err
