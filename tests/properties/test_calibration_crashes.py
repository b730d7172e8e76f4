import json
import os
import subprocess
import sys

import pytest
from harness import killed_writer

from so101_motion.calib.record import store
from so101_motion.calib.record.record import JointCalibration

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="nothing is killed with -9 there")

JAW = {"gripper": JointCalibration(id=6, norm_mode=1)}


def known(calibration, zeros):
    return calibration, {joint: (z.by, round(z.angle, 4)) for joint, z in zeros.items()}


OLD = known(killed_writer.OLD, killed_writer.OLD_ZEROS)
NEW = known(killed_writer.NEW, killed_writer.NEW_ZEROS)


@pytest.fixture
def killed(tmp_path, monkeypatch):
    """The folders that a killed writer leaves, by the step it died at."""
    monkeypatch.setattr(os, "fsync", lambda _: None)

    def at_every_step(what):
        subprocess.run(
            [sys.executable, killed_writer.__file__, str(tmp_path), what], check=True, timeout=100
        )
        folders = sorted(tmp_path.iterdir(), key=lambda folder: int(folder.name))
        for folder in folders:
            monkeypatch.setenv("VIAM_MODULE_DATA", str(folder / "module"))
            monkeypatch.setenv("XDG_DATA_HOME", str(folder / "home"))
            yield folder, folder / "module" / "arm.json"

    return at_every_step


@pytest.mark.parametrize("what", ["save", "restore"])
def test_a_writer_killed_at_any_step_leaves_the_old_or_the_new_calibration(killed, what):
    before, after = (OLD, NEW) if what == "save" else (NEW, OLD)
    seen = []
    for _, file in killed(what):
        found = store.load(file)
        seen.append(known(found.calibration, found.zeros))
        assert json.loads(file.read_bytes())["elbow_flex"]["id"] == 3
        assert found.notes == ()

    assert len(seen) > 20  # it is a matter of many steps
    assert set(map(str, seen)) == {str(before), str(after)}
    assert seen == sorted(seen, key=lambda one: one == after), "back and forth"


@pytest.mark.parametrize("what", ["save", "restore", "load"])
def test_after_a_kill_at_any_step_everything_works_again(killed, what):
    for folder, file in killed(what):
        store.load(file)
        found = store.save(file, JAW)

        assert set(found.calibration) == {"elbow_flex", "gripper"}
        assert not [name for name in os.listdir(folder / "module") if name.endswith(".tmp")]
        states = [store.read(version.path) for version in store.versions(file)]
        assert any(known(s.calibration, s.zeros) == OLD for s in states)


def test_a_loader_killed_while_it_brings_a_file_back_can_be_started_again(killed):
    for _, file in killed("load"):
        found = store.load(file)

        assert known(found.calibration, found.zeros) == OLD
