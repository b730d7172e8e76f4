import csv
import json

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS
from so101_motion.files.trajectory_export import Run, export
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point


@pytest.fixture(scope="module")
def trajectory():
    limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=20.0)
    return point_to_point(np.zeros(5), np.array([0.5, -0.2, 0.1, 0.3, 0.0]), limits, 0.01)


def test_csv_has_a_row_for_each_setpoint_and_json_holds_the_motion_with_units_in_the_names(
    trajectory, tmp_path
):
    export(trajectory, tmp_path / "move.csv")
    rows = list(csv.DictReader((tmp_path / "move.csv").read_text().splitlines()))
    assert len(rows) == len(trajectory)
    assert float(rows[-1]["time_s"]) == pytest.approx(trajectory.t[-1])
    end = [float(rows[-1][f"{joint}_deg"]) for joint in ARM_JOINTS]
    np.testing.assert_allclose(end, np.degrees(trajectory.q[-1]), atol=1e-6)
    assert "wrist_roll_deg_per_s2" in rows[0]
    export(trajectory, tmp_path / "move.json")
    content = json.loads((tmp_path / "move.json").read_text())
    assert content["joints"] == list(ARM_JOINTS)
    assert content["dt_s"] == trajectory.dt
    np.testing.assert_allclose(content["qd_deg_per_s"], np.degrees(trajectory.qd), atol=1e-9)


def read_mcap(path):
    """Each message and its topic, as another reader understands them."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [(entry[1].topic, entry[3]) for entry in reader.iter_decoded_messages()]


def test_mcap_holds_ros_joint_states_that_other_readers_understand(trajectory, tmp_path):
    export(trajectory, tmp_path / "move.mcap")
    topics, messages = zip(*read_mcap(tmp_path / "move.mcap"), strict=True)
    assert set(topics) == {"/joint_commands"}
    assert len(messages) == len(trajectory)
    assert messages[0].name == list(ARM_JOINTS)
    np.testing.assert_allclose(messages[-1].position, trajectory.q[-1])
    stamp = messages[-1].header.stamp
    assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(trajectory.t[-1])


def test_an_unknown_format_and_a_file_that_cannot_be_written_are_refused(trajectory, tmp_path):
    with pytest.raises(ConfigError, match=r"\.csv, \.json, \.mcap"):
        export(trajectory, tmp_path / "move.xlsx")
    with pytest.raises(ConfigError, match="cannot be written"):
        export(trajectory, tmp_path / "no" / "such" / "folder.csv")


@pytest.fixture(scope="module")
def run():
    q_ref = np.linspace(np.zeros(5), np.full(5, 0.5), 4)
    return Run(t=np.array([0.0, 0.03, 0.06, 0.09]), q_ref=q_ref, q=q_ref - 0.01)


def test_a_run_is_written_as_wanted_and_as_measured(run, tmp_path):
    export(run, tmp_path / "run.csv")
    rows = list(csv.DictReader((tmp_path / "run.csv").read_text().splitlines()))
    assert len(rows) == 4
    off = float(rows[2]["elbow_flex_measured_deg"]) - float(rows[2]["elbow_flex_deg"])
    assert off == pytest.approx(np.degrees(-0.01), abs=1e-5)
    export(run, tmp_path / "run.json")
    content = json.loads((tmp_path / "run.json").read_text())
    assert content["schema"] == "so101/run/1"
    np.testing.assert_allclose(content["q_measured_deg"], np.degrees(run.q), atol=1e-9)
    export(run, tmp_path / "run.mcap")
    read = read_mcap(tmp_path / "run.mcap")
    states = [message for topic, message in read if topic == "/joint_states"]
    assert len(states) == len(read) / 2 == 4
    np.testing.assert_allclose(states[-1].position, run.q[-1])
