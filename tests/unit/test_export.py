import csv
import json
import sys

import numpy as np
import pytest

from so101_motion.errors import ConfigError
from so101_motion.export import export
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.online import point_to_point
from so101_motion.state import ARM_JOINTS


@pytest.fixture(scope="module")
def trajectory():
    limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=20.0)
    return point_to_point(np.zeros(5), np.array([0.5, -0.2, 0.1, 0.3, 0.0]), limits, 0.01)


def test_csv_has_a_row_for_each_setpoint_and_the_unit_in_each_name(trajectory, tmp_path):
    export(trajectory, tmp_path / "move.csv")
    rows = list(csv.DictReader((tmp_path / "move.csv").read_text().splitlines()))
    assert len(rows) == len(trajectory)
    assert float(rows[-1]["time_s"]) == pytest.approx(trajectory.t[-1])
    end = [float(rows[-1][f"{joint}_deg"]) for joint in ARM_JOINTS]
    np.testing.assert_allclose(end, np.degrees(trajectory.q[-1]), atol=1e-6)
    assert "wrist_roll_deg_per_s2" in rows[0]


def test_json_holds_the_motion(trajectory, tmp_path):
    export(trajectory, tmp_path / "move.json")
    content = json.loads((tmp_path / "move.json").read_text())
    assert content["joints"] == list(ARM_JOINTS)
    assert content["dt_s"] == trajectory.dt
    np.testing.assert_allclose(content["qd_deg_per_s"], np.degrees(trajectory.qd), atol=1e-9)


def test_mcap_holds_ros_joint_states_that_other_readers_understand(trajectory, tmp_path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    path = tmp_path / "move.mcap"
    export(trajectory, path)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages = [entry[3] for entry in reader.iter_decoded_messages(["/joint_commands"])]
    assert len(messages) == len(trajectory)
    assert messages[0].name == list(ARM_JOINTS)
    np.testing.assert_allclose(messages[-1].position, trajectory.q[-1])
    stamp = messages[-1].header.stamp
    assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(trajectory.t[-1])


def test_an_unknown_format_is_refused_with_those_that_there_are(trajectory, tmp_path):
    with pytest.raises(ConfigError, match=r"\.csv, \.json, \.mcap"):
        export(trajectory, tmp_path / "move.xlsx")


def test_a_file_that_cannot_be_written_is_named(trajectory, tmp_path):
    with pytest.raises(ConfigError, match="cannot be written"):
        export(trajectory, tmp_path / "no" / "such" / "folder.csv")


def test_without_the_mcap_package_the_command_to_install_it_is_given(
    trajectory, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    with pytest.raises(ConfigError, match="pip install"):
        export(trajectory, tmp_path / "move.mcap")
