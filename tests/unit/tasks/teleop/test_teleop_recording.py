import csv
import sys

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.tasks.teleop.recording import JOINTS, RecordedSample, Recorder
from so101_motion.tasks.teleop.sides import SideState

MIDDLES = np.radians([4.0, -1.0, 0.0, 0.0, 0.0])
ARMS = ("leader", "follower")
LOADS = (0.1, -0.2, 0.3, 0.0, 0.0, 0.25)


def row(t, lead=0.0):
    leader = np.radians([10.0 + lead, 0.0, 0.0, 0.0, 0.0, 0.0]) + np.array([0, 0, 0, 0, 0, 0.5])
    follower = 0.9 * leader
    return RecordedSample(
        t=t,
        leader=SideState(x=leader, x_goal=leader, loads=LOADS),
        action=leader,
        follower=SideState(x=follower, x_goal=leader, loads=()),
        state="mirroring",
    )


def recorded(path, rows, **options):
    recorder = Recorder(path, **options)
    for each in rows:
        recorder.take(each)
    recorder.close()
    recorder.close()
    return recorder


def read(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_csv_speaks_lerobots_language(tmp_path):
    recorded(tmp_path / "a.csv", [row(5.0), row(5.01, 1.0)], middles=MIDDLES)
    first, second = read(tmp_path / "a.csv")
    names = [f"{joint}.pos" for joint in JOINTS]
    assert names[0] == "shoulder_pan.pos"
    assert names[-1] == "gripper.pos"
    for group in ("action", "observation.state", "leader"):
        assert all(f"{group}.{name}" in first for name in names)
    for joint in JOINTS:
        assert all(f"{arm}.{joint}.{what}" in first for arm in ARMS for what in ("goal", "load"))
    assert float(first["leader.shoulder_pan.goal"]) == pytest.approx(10.0 - 4.0)
    assert float(first["follower.gripper.goal"]) == pytest.approx(50.0)
    assert float(first["action.shoulder_pan.pos"]) == pytest.approx(10.0 - 4.0)
    assert float(first["observation.state.shoulder_pan.pos"]) == pytest.approx(9.0 - 4.0)
    assert float(first["action.shoulder_lift.pos"]) == pytest.approx(1.0)
    assert float(first["action.gripper.pos"]) == pytest.approx(50.0)
    assert float(second["action.shoulder_pan.pos"]) == pytest.approx(11.0 - 4.0)
    assert (first["timestamp"], second["timestamp"]) == ("0.000000", "0.010000")
    assert first["episode_index"] == "0"
    assert first["state"] == "mirroring"
    assert float(first["leader.shoulder_lift.load"]) == -0.2
    assert first["follower.shoulder_lift.load"] == "nan", "it does not tell"


def test_frames_are_counted_without_holes(tmp_path):
    rows = [row(10.0 + 0.01 * k, k) for k in range(100) if not 40 < k < 60]
    recorded(tmp_path / "a.csv", rows, fps=30.0)
    frames = read(tmp_path / "a.csv")
    assert [int(frame["frame_index"]) for frame in frames] == list(range(len(frames)))
    assert len(frames) == pytest.approx(30, abs=1)
    for k, frame in enumerate(frames):
        assert float(frame["timestamp"]) == pytest.approx(k / 30.0, abs=1e-6)
        late = float(frame["action.shoulder_pan.pos"]) - 10.0 - 100.0 * k / 30.0
        assert abs(late) <= 1.7 or 40 < 100.0 * k / 30.0 < 60


def test_mcap_holds_both_arms_in_ros_messages(tmp_path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    recorded(tmp_path / "a.mcap", [row(5.0), row(5.01, 1.0)], epoch=1_000_000_000.0)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [(e[1].topic, e[2].log_time, e[3]) for e in reader.iter_decoded_messages()]
    assert {topic for topic, _, _ in found} == {
        "/follower/state",
        *(f"/{arm}/{what}" for arm in ARMS for what in ("joint_states", "joint_commands")),
    }
    states = [message.data for topic, _, message in found if topic == "/follower/state"]
    assert states == ["mirroring"] * 2
    topic, at_ns, message = found[0]
    assert topic == "/leader/joint_states"
    assert at_ns == 1_000_000_005_000_000_000
    assert message.name == list(JOINTS)
    assert message.position[0] == pytest.approx(np.radians(10.0))
    assert message.position[5] == pytest.approx(0.5)
    assert list(message.effort) == pytest.approx(LOADS)


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("a.xlsx", {}, r"\.csv, \.mcap"),
        ("no/such/folder/a.csv", {}, "cannot be written"),
        ("no/such/folder/a.mcap", {}, "cannot be written"),
        ("a.csv", {"fps": 0.0}, "0.1 to 1000"),
    ],
)
def test_an_impossible_recording_is_refused_before_it_begins(tmp_path, name, options, says):
    with pytest.raises(ConfigError, match=says):
        Recorder(tmp_path / name, **options)


def test_without_the_mcap_package_the_command_to_install_it_is_given(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    with pytest.raises(ConfigError, match="pip install"):
        Recorder(tmp_path / "a.mcap")
    assert not (tmp_path / "a.mcap").exists()


def test_a_full_disk_ends_the_record_and_nothing_else(tmp_path, caplog):
    (tmp_path / "a.csv").symlink_to("/dev/full")
    recorder = recorded(tmp_path / "a.csv", [row(0.01 * k) for k in range(500)])
    assert "cannot be written any more" in caplog.text
    assert recorder.rows < 500
