"""Which commands store something in the servos: only those that were asked to."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

from so101_motion.cli.verbs import main as cli
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions

ROWS = {
    "shoulder_pan": (1, -100, 693, 3400),
    "shoulder_lift": (2, 40, 851, 3223),
    "elbow_flex": (3, -120, 948, 3145),
    "wrist_flex": (4, 90, 890, 3210),
    "wrist_roll": (5, -700, 0, 4094),
    "gripper": (6, 150, 2030, 3260),
}


def file_of(path, shift):
    rows = {
        joint: {"id": i, "homing_offset": o + shift, "range_min": a, "range_max": b}
        for joint, (i, o, a, b) in ROWS.items()
    }
    path.write_text(json.dumps(rows))
    return str(path)


@pytest.fixture
def arm(tmp_path):
    q = tuple(map(math.radians, (0, -45, 45, 60, 0, 20)))
    emulator = Emulator(EmulatorOptions(link=tmp_path / "arm", q_start=q), gravity=np.zeros_like)
    with emulator.world.lock:
        for servo, (_, offset, lower, upper) in zip(
            emulator.world.servos, ROWS.values(), strict=True
        ):
            servo.memory.keep(reg.OFFSET, offset if offset >= 0 else -offset | 2048)
            servo.memory.keep(reg.MIN_POSITION, lower)
            servo.memory.keep(reg.MAX_POSITION, upper)
            servo.memory.keep(reg.STATUS_LEVEL, 0)  # to be repaired whenever it is driven
    yield emulator
    emulator.close()


def stored(emulator):
    with emulator.world.lock:
        return [servo.memory.flash for servo in emulator.world.servos]


GOAL = ("--joints", "0,-40,45,60,0")


@pytest.mark.parametrize(
    ("verb", "shift", "code", "stores"),
    [
        (("status",), 30, 0, False),
        (("plan", *GOAL), 30, 0, False),
        (("move", *GOAL, "--yes"), 30, 4, False),
        (("move", *GOAL, "--yes"), 0, 0, False),
        (("move", *GOAL, "--yes"), 1, 0, False),  # the published module is a tick off
    ],
)
def test_only_what_was_asked_for_is_stored(arm, tmp_path, verb, shift, code, stores):
    file, before = file_of(tmp_path / "other.json", shift), stored(arm)
    place = ("--port", str(tmp_path / "arm"), "--calibration", file)
    result = CliRunner().invoke(cli, [*verb, *place])
    assert result.exit_code == code or (code and result.exception), result.output
    assert (stored(arm) != before) is stores
    if shift > 1:
        assert "so101 calibration write" in result.output + str(result.exception)


def test_a_written_calibration_can_be_put_back(arm, tmp_path):
    file, before, port = file_of(tmp_path / "other.json", 30), stored(arm), str(tmp_path / "arm")
    result = CliRunner().invoke(cli, ["calibration", "write", file, "--port", port, "--yes"])
    assert result.exit_code == 0, result.output
    assert stored(arm) != before
    kept = result.output.split("so101 calibration write ")[1].split(" --port")[0]
    CliRunner().invoke(cli, ["calibration", "write", kept, "--port", port, "--yes"])
    assert stored(arm) == before
