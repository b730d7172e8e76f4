"""Teaching a path to the arm of a running machine, as the page does."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import numpy as np
import pytest
from harness.fake_parent import ARM, SIMULATED
from harness.viam_machine import running_machine, until_true

from so101_motion.common.errors import So101Error
from so101_motion.common.modes import Mode
from so101_motion.tasks.guided import GuidedPath, files
from so101_motion.viam.client import MachineRig

FAST = {"speed_degs_per_sec": 90.0, "acceleration_degs_per_sec_per_sec": 400.0}
WAVE = np.radians([[0.0, -30.0, 30.0, 20.0, 0.0], [40.0, -40.0, 20.0, 0.0, 0.0]])


def test_a_path_on_a_machine_is_recorded_planned_replayed_stopped_deleted_and_restored(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("VIAM_MODULE_DATA", str(tmp_path))
    files.write(GuidedPath(t=np.array([0.0, 5.0]), q=WAVE), tmp_path / "paths" / "wave.json")
    with (
        running_machine(resources=((ARM, SIMULATED, "arm", FAST),)) as machine,
        MachineRig.connect(machine.address, arm="arm") as rig,
        closing(rig.operation("teaching", ("run",))) as teaching,
        ThreadPoolExecutor(1) as pool,
    ):
        teaching.ask("record", name="wave")
        assert teaching.view.text.startswith('Recording "wave 2", 1 point.')
        assert teaching.ask("end")["name"] == "wave 2"
        assert (tmp_path / "paths" / "wave 2.json").exists()
        teaching.ask("delete_path", name="wave 2")
        assert not (tmp_path / "paths" / "wave 2.json").exists()
        back = teaching.view.offer("restore_path")
        teaching.ask(back.command, **back.arguments)
        assert (tmp_path / "paths" / "wave 2.json").exists()

        rig.do_command("arm", {"set_speed": 3.0})
        until_true(lambda: rig.refresh().mode is Mode.HOLDING)
        teaching.ask("plan", name="wave")
        assert "s to its start" in teaching.view.text
        assert len(teaching.view.picture.line) > 1
        running = pool.submit(teaching.ask, "run")
        until_true(lambda: rig.refresh().mode is Mode.MOVING)
        rig.arm.stop()
        with pytest.raises(So101Error, match="stop"):
            running.result(60.0)
        until_true(lambda: rig.refresh() and "Press Plan replay" in teaching.view.text)
        assert np.abs(rig.refresh().q - WAVE[-1]).max() > np.radians(5.0)
