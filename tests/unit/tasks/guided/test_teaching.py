"""Teaching as an operation, on a simulated arm and a clock the test drives."""

from functools import partial

import numpy as np
import pytest
from harness.facing_arms import in_time

from so101_motion.common.errors import MotionError, NotPossibleNow
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.planning.goals import JointGoal
from so101_motion.tasks.guided.teaching import GUIDED_FOR, TeachingOperation

AWAY = np.radians([25.0, -15.0, 10.0, 10.0, 0.0])


class Bench:
    def __init__(self, guest, folder):
        self.guest, self.rig, self.clock = guest, guest.rig, guest.clock
        self.teaching = TeachingOperation(guest.rig, lambda: folder)

    def ask(self, command, each=lambda: None, **arguments):
        ask = partial(self.teaching.ask, command, **arguments)
        return in_time(self.clock, ask, each)

    def lead(self):
        self.guest.lead(np.degrees(AWAY), seconds=0.5)

    def record(self, name=""):
        self.ask("record", name=name)
        self.lead()
        return self.ask("end")

    def can(self, command):
        offer = self.teaching.view.offer(command)
        return offer is not None and offer.why_not is None


@pytest.fixture
def bench(guest, tmp_path):
    guest.rig.arm.set_speed(to_rad(180.0))
    guest.rig.arm.set_acceleration(to_rad(500.0))
    return Bench(guest, tmp_path / "paths")


def test_a_path_is_recorded_planned_and_replayed_as_it_was_planned(bench):
    teaching, rig = bench.teaching, bench.rig
    assert "simulated arm cannot be guided by hand" in teaching.view.text
    assert not bench.can("plan")
    assert bench.ask("record") == {"recording": "path", "mode": "manual"}
    (end,) = teaching.view.offers
    assert (end.command, end.due_in) == ("end", pytest.approx(GUIDED_FOR, abs=1.0))
    assert teaching.view.text.startswith('Recording "path", 1 point. A simulated arm stands still.')
    bench.lead()
    assert bench.ask("end")["name"] == "path"
    assert rig.arm.state.mode is Mode.HOLDING
    assert '"path" is saved: ' in teaching.view.text
    np.testing.assert_allclose(rig.arm.state.q, AWAY, atol=to_rad(0.1))
    assert len(teaching.view.picture.line) > 2

    with pytest.raises(NotPossibleNow, match="not planned"):
        bench.ask("run")
    bench.ask("plan", name="path")
    assert "to its start" in teaching.view.text
    np.testing.assert_allclose(rig.arm.state.q, AWAY, atol=to_rad(0.1))  # nothing moved
    far = []
    bench.ask("run", each=lambda: far.append(np.abs(rig.arm.state.q - AWAY).max()))
    assert max(far) > to_rad(20.0)  # it went to the beginning
    np.testing.assert_allclose(rig.arm.state.q, AWAY, atol=to_rad(0.5))
    assert teaching.view.text.startswith("Done.")


def test_each_recording_is_kept_and_what_is_deleted_comes_back(bench):
    assert [bench.record()["name"], bench.record()["name"]] == ["path", "path 2"]
    plan = bench.teaching.view.offer("plan")
    assert (plan.arguments, plan.inputs["name"].choices) == (
        {"name": "path 2"}, ("path", "path 2"),
    )  # fmt: skip
    bench.ask("delete_path", name="path 2")
    plan, back = bench.teaching.view.offer("plan"), bench.teaching.view.offer("restore_path")
    assert plan.arguments == {"name": "path"}
    assert back.title == "Bring back path 2"
    bench.ask(back.command, **back.arguments)
    assert bench.teaching.view.offer("plan").inputs["name"].choices == ("path", "path 2")
    assert bench.teaching.view.offer("restore_path") is None


def test_a_stop_ends_the_recording_and_what_was_shown_is_kept(bench):
    bench.ask("record", name="wave")
    bench.lead()
    in_time(bench.clock, bench.rig.arm.stop)
    assert bench.ask("end_path")["ended_by"] == "manual mode ended"
    assert "The recording ended: manual mode ended." in bench.teaching.view.text
    assert [each["name"] for each in bench.ask("list_paths")["paths"]] == ["wave"]


def test_a_replay_is_planned_anew_when_the_arm_was_moved(bench):
    bench.record()
    bench.ask("plan", name="path")
    assert bench.can("run")
    in_time(bench.clock, partial(bench.rig.arm.move, JointGoal(q=np.zeros(5))))
    assert bench.teaching.view.text == "The arm has moved. Press Plan replay again."
    assert not bench.can("run")
    with pytest.raises(NotPossibleNow):
        bench.ask("run")
    bench.ask("plan", name="path")
    in_time(bench.clock, partial(bench.rig.arm.set_torque, False))
    assert "press Hold first" in bench.teaching.view.text
    assert "Press Replay" not in bench.teaching.view.text


def test_closing_saves_what_is_being_recorded(bench, tmp_path):
    with pytest.raises(MotionError, match="nothing is being recorded"):
        bench.ask("end_path")
    bench.ask("record", name="wave")
    bench.lead()
    bench.teaching.close()
    assert (tmp_path / "paths" / "wave.json").exists()
