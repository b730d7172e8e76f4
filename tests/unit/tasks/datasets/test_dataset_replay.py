import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from harness.command_line import refused
from harness.facing_arms import in_time
from harness.lerobot_data import NAMES, late, swing, write_data_set

from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero import Zero, encoder_zeros
from so101_motion.common.errors import ConfigError, Interrupted, PlanningError
from so101_motion.common.state import ARM_JOINTS
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.tasks.datasets import convert_data_set, open_data_set, units_of
from so101_motion.tasks.datasets.replay import plan_episode, replay_episode

pytestmark = pytest.mark.usefixtures("planning_process")

MODEL = units_of("model")


@pytest.fixture
def rig(clock):
    with open_simulated(clock=clock) as rig:
        rig.arm.set_speed(np.radians(180.0))
        rig.arm.set_acceleration(np.radians(500.0))
        yield rig


def set_of(tmp_path, *episodes, **how):
    return open_data_set(write_data_set(tmp_path / "set", list(episodes), **how))


def test_an_episode_is_replayed_in_its_own_time_and_the_deviation_is_reported(tmp_path, clock, rig):
    data_set = set_of(tmp_path, swing(), swing(60, phase=1.0))
    replay = plan_episode(rig, data_set, 1, units=MODEL)
    assert replay.duration == pytest.approx(59 / 30)
    assert not replay.beyond
    goals = []
    rig.executor.listen(lambda state: goals.append(state.q_ref))
    outcome = in_time(clock, lambda: replay_episode(rig, replay))
    assert np.abs(np.diff(goals, axis=0)).max() <= np.radians(1.81), "a step of its cap"
    assert np.abs(rig.arm.state.q - replay.q[-1]).max() < np.radians(0.1)
    assert rig.gripper.aperture == pytest.approx(replay.aperture[-1], abs=0.02)
    assert outcome.differences.lag_s < 0.2
    assert max(outcome.differences.rms_deg.values()) < 1.0
    assert not outcome.held_by


def test_a_jump_in_the_recording_is_no_jump_of_the_arm(tmp_path, clock, rig):
    action = swing(40)
    action[20:, 0] += 60.0
    replay = plan_episode(rig, set_of(tmp_path, action), 0, units=MODEL)
    goals = []
    rig.executor.listen(lambda state: goals.append(state.q_ref))
    outcome = in_time(clock, lambda: replay_episode(rig, replay))
    assert np.abs(np.diff(goals, axis=0)).max() <= np.radians(1.81)
    assert outcome.differences.worst_deg["shoulder_pan"] > 20.0


def test_a_recording_into_the_table_ends_above_it_and_says_so(tmp_path, clock, rig):
    action = swing(45)
    action[15:, 1:4] += np.linspace(0, 1, 30)[:, None] * [70, 20, 10]
    replay = plan_episode(rig, set_of(tmp_path, action), 0, units=MODEL)
    lowest = []
    rig.executor.listen(lambda state: lowest.append(rig.arm.T_base("tool").p[2]))
    outcome = in_time(clock, lambda: replay_episode(rig, replay))
    assert any("floor" in what for what in outcome.held_by)
    assert outcome.held_s > 0.1
    assert min(lowest) > 0.0


def test_where_the_joints_were_can_be_replayed_and_from_later_on(tmp_path, rig):
    action, state = swing(), late(swing())
    state[:, 1] -= 3.0
    data_set = set_of(tmp_path, (action, state))
    replay = plan_episode(rig, data_set, 0, units=MODEL, of="state", start=1.0)
    assert np.degrees(replay.q[0]) == pytest.approx(state[30, :5], abs=1e-3)
    assert replay.duration == pytest.approx(59 / 30)


def test_what_is_beyond_the_range_waits_at_the_limit_and_is_reported(tmp_path, rig):
    action = swing()
    action[50:60, 1] = -104.0
    replay = plan_episode(rig, set_of(tmp_path, action), 0, units=MODEL)
    assert replay.beyond == {"shoulder_lift": 10}
    assert replay.q[:, 1].min() == rig.arm.range.lower[1]


def test_a_stop_ends_it(tmp_path, clock, rig):
    replay = plan_episode(rig, set_of(tmp_path, swing()), 0, units=MODEL)
    moved, stopped = 0, []

    def stop_later():  # time passes while threads are started and plans are made, too
        nonlocal moved
        moved += (moving := rig.arm.state.arm_moving)
        if 0.01 * moved > replay.approach.duration + 1.0 and moving and not stopped:
            stopped.append(rig.arm.start_stop())

    with pytest.raises(Interrupted):
        in_time(clock, lambda: replay_episode(rig, replay), stop_later)
    assert stopped


def test_an_arm_whose_jaw_is_not_recorded_keeps_it(tmp_path, clock, rig):
    data_set = set_of(tmp_path, swing(30)[:, :5], names=NAMES[:5])
    replay = plan_episode(rig, data_set, 0, units=MODEL)
    before = rig.gripper.aperture
    in_time(clock, lambda: replay_episode(rig, replay))
    assert rig.gripper.aperture == pytest.approx(before, abs=0.01)


def test_an_impossible_episode_is_refused_before_anything_moves(tmp_path, rig):
    gap, table = swing(), swing()
    gap[40] = np.nan
    table[:, 1:4] = [40, 40, 40]
    data_set = set_of(tmp_path, gap, table)
    with pytest.raises(ConfigError, match="frame 40 of episode 0"):
        plan_episode(rig, data_set, 0, units=MODEL)
    with pytest.raises(PlanningError, match="first frame of episode 1"):
        plan_episode(rig, data_set, 1, units=MODEL)
    with pytest.raises(ConfigError, match="no episode 2; there are 0 to 1"):
        plan_episode(rig, data_set, 2, units=MODEL)
    with pytest.raises(ConfigError, match=r"3\.0 s long"):
        plan_episode(rig, data_set, 0, units=MODEL, start=4.0)
    assert not rig.arm.state.arm_moving


@pytest.fixture
def run(so101, tmp_path):
    """Runs the command on a short episode."""
    short = write_data_set(tmp_path / "set", [swing(8)])
    return lambda line, **how: so101(f"dataset replay --episode 0 --sim {line}", short, **how)


def test_the_command_goes_and_tells(run):
    result = run("--units model --yes --json")
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert content["schema"] == "so101/dataset-replay/1"
    assert content["differences"]["rms_deg"]["shoulder_pan"] < 3.0
    assert content["held_by"] == []


def test_the_command_asks_first_and_does_not_guess_units(run):
    assert "to the first frame, then 0.2 s as recorded" in refused(
        run("--units model", input="n\n"), 7
    )
    assert "give --units" in refused(run("--yes"))


def test_the_time_stamps_are_followed(tmp_path, rig):
    data_set = set_of(tmp_path, swing(), timestamps={0: 3.0 + np.arange(90) / 15})
    replay = plan_episode(rig, data_set, 0, units=MODEL, start=2.0)
    assert (replay.duration, replay.fps) == pytest.approx((89 / 15 - 2.0, 15.0), abs=1e-3)


def test_time_stamps_that_do_not_increase_and_other_units_are_refused(tmp_path, rig):
    t = np.arange(90) / 30
    t[40] = t[39]
    data_set = set_of(tmp_path, swing(), timestamps={0: t})
    with pytest.raises(ConfigError, match="frame 40 of episode 0"):
        plan_episode(rig, data_set, 0, units=MODEL)
    (data_set.metadata.root / "meta/so101_units.json").write_text('{"units": "old"}')
    with pytest.raises(ConfigError, match="declares old"):
        plan_episode(rig, data_set, 0, units=MODEL)


def calibration(name, *, off=0, horn=0):
    """A calibration whose elbow has its zero ``off`` ticks, and all joints ``horn``, elsewhere."""
    entries = {}
    for i, joint in enumerate(JOINTS, start=1):
        moved = off * (joint == "elbow_flex")
        entries[joint] = JointCalibration(
            id=i, homing_offset=horn, range_min=900 + moved, range_max=3100 + moved
        )
    zeros = dict.fromkeys(ARM_JOINTS, Zero(by="pose", angle=0.0))
    return Stored(path=Path(name), calibration=entries, zeros=zeros, notes=())


@pytest.mark.parametrize(
    ("off", "horn", "moved_deg"),
    [
        (0, 0, 0.0),
        (57, 0, -5.01),  # this arm was calibrated anew: it stands where it stood
        (0, 700, 0.0),  # another arm: the model's angles count
    ],
)
def test_a_data_set_knows_its_calibration(tmp_path, rig, monkeypatch, off, horn, moved_deg):
    made = calibration("made.json")
    units = units_of("degrees", made)
    convert_data_set(set_of(tmp_path, swing(8)), tmp_path / "new", source=MODEL, target=units)
    data_set = open_data_set(tmp_path / "new")
    assert data_set.calibration.calibration == made.calibration
    now = calibration("now.json", off=off, horn=horn)
    here = replace(rig.connection, encoder_zeros=encoder_zeros(now.calibration, now.zeros))
    monkeypatch.setattr(type(rig), "connection", here)
    replay = plan_episode(rig, data_set, 0, units=units_of("degrees", data_set.calibration))
    expected = swing(8)[:, :5] + np.array([0.0, 0.0, moved_deg, 0.0, 0.0])
    assert np.degrees(replay.q) == pytest.approx(expected, abs=0.06)
    if off:
        with pytest.raises(ConfigError, match="is not that of the data set"):
            plan_episode(rig, data_set, 0, units=units_of("degrees", now))
