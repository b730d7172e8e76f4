"""The seconds before a failure are kept as a file, and the error names it."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from so101_viewer.panels.health_panel import figures, read_health

from so101_motion.cli.verbs import main
from so101_motion.common.errors import FollowingError
from so101_motion.files import failure_record

JOINT = "shoulder_pan"


def fail(bench, rig):
    """A joint that is held fast in the middle of a motion; what the motion ends with."""
    motion = bench.go(rig, 80, 0, 0, 0, 0)
    bench.under_way(motion, rig, 1.0)
    shaft = bench.world.servo(JOINT).drive.shaft
    upper, shaft.upper = shaft.upper, shaft.output + 5
    with pytest.raises(FollowingError, match=JOINT) as caught:
        bench.finish(motion)
    shaft.upper = upper
    return caught.value


def told(error):
    return Path(error.__notes__[0].removeprefix("The second before is recorded in "))


def test_a_motion_that_fails_names_the_file_with_the_second_before(bench, tmp_path):
    rig = bench.open()
    error = fail(bench, rig)
    bench.shut(rig)
    report = tmp_path / "report.md"
    assert CliRunner().invoke(main, ["doctor", "--sim", "--report", str(report)]).exit_code == 0
    assert str(told(error)) in report.read_text()
    kept = json.loads(told(error).read_text())
    assert kept["schema"] == failure_record.SCHEMA
    assert kept["error"] == str(error)
    times = [state["t_s"] for state in kept["states"]]
    assert len(times) == len(error.recent) > 90
    assert times == sorted(times)
    assert (times[0], times[-1]) == pytest.approx((-1.0, 0.0), abs=0.02)
    last = kept["states"][-1]
    assert abs(last["q_ref_deg"][0] - last["q_deg"][0]) > 1.5
    assert failure_record.newest() == (told(error),)


def test_a_fault_names_it_too_and_only_so_many_are_kept(bench, monkeypatch, caplog):
    monkeypatch.setattr(failure_record, "KEPT", 2)
    caplog.set_level("INFO")
    rig = bench.open()
    bench.advance(1.0)
    seen = []
    for _ in range(3):
        bench.emulator.unplug()
        bench.advance(0.5)
        seen.append(rig.last_failure)
        assert f"The second before is recorded in {seen[-1]}" in caplog.text
        assert seen[-1].name in figures(read_health(rig))
        bench.emulator.plug()
        bench.advance(3.0)
        bench.finish(rig.executor.hold())
        bench.advance(1.0)
    bench.shut(rig)
    assert failure_record.newest() == tuple(reversed(seen[1:]))
    assert all(json.loads(path.read_text())["states"] for path in seen[1:])
