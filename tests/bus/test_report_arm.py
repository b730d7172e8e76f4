"""``so101 report-arm``: what its file holds, and what happens before the arm moves."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from harness.emulated_rig import hardware_bench

from benchmarks.emulated_arm import arm_of, load
from so101_motion.cli.measuring import nameless, text
from so101_motion.cli.verbs import main
from so101_motion.common.errors import Interrupted
from so101_motion.setup.identify import Identification, StandardMotions


@pytest.fixture
def bench(tmp_path):
    with hardware_bench(tmp_path, reply_timeout=2.0) as bench:
        yield bench


def moved(bench, motions, outline, until=lambda: False):
    with ThreadPoolExecutor(1) as beside:
        moving = beside.submit(motions.move_and_record, outline)
        while not moving.done():
            bench.advance(0.05)
            if until():
                motions.cancel()
        return moving.result()


def test_motions_are_recorded_in_the_format_that_the_benchmark_reads(bench, tmp_path):
    rig = bench.open()
    bench.advance(1.0)
    motions = StandardMotions(rig)
    outline = Identification(rig).outline()
    outline = replace(outline, sweeps=outline.sweeps[:1])
    recorded = moved(bench, motions, outline)
    with ThreadPoolExecutor(1) as beside:
        asked = beside.submit(motions.registers)
        while not asked.done():
            bench.advance(0.01)
    file = tmp_path / "arm.json"
    file.write_text(text({"servos": asked.result()}, recorded))
    assert json.loads(file.read_text())["motions"] == recorded
    (motion,) = load(file).values()
    low, high = outline.sweeps[0].ends
    for name, near in (("command", 0.02), ("position", 0.01)):
        pan = motion[name][:, 0]
        np.testing.assert_allclose((pan.min(), pan.max()), (low, high), atol=near)
    assert motion["t_s"][0] == 0.0
    assert np.diff(motion["t_cmd_s"]).min() >= 0.0
    assert arm_of(file).registers["p_gain"] == 32


def test_an_arm_that_is_stopped_holds_and_the_recording_is_an_error(bench):
    rig = bench.open()
    bench.advance(1.0)
    motions = StandardMotions(rig)
    with pytest.raises(Interrupted):
        moved(bench, motions, Identification(rig).outline(), until=lambda: rig.arm.state.arm_moving)
    assert np.abs(rig.arm.state.qd_ref).max() == 0.0


def test_a_report_needs_servos_and_names_no_port_and_no_folder(tmp_path):
    result = CliRunner().invoke(main, ["report-arm", str(tmp_path / "a.json"), "--sim"])
    assert result.exit_code == 2
    assert "no servos" in result.output
    said = "/dev/ttyACM0 is open (C:\\users\\me\\58FA.json, /home/me/a); 50 deg/s"
    assert nameless(said) == "(path) is open ((path), (path)); 50 deg/s"
