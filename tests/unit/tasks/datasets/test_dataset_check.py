import sys

import numpy as np
import pytest
from harness.lerobot_data import NAMES, late, pa, pq, swing, write_data_set

from so101_motion.calib.record.record import JOINTS
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.tasks.datasets import check_data_set, open_data_set, units_of

MAIN, ARM = (tuple(f"{prefix}_{joint}" for joint in JOINTS) for prefix in ("main", "arm"))
ARM = tuple(f"{name}.pos" for name in ARM)


def checked(root, episodes, *, scene=None, units="model", **how):
    """The report on a data set of these episodes, in degrees with the model's zero."""
    data_set = open_data_set(write_data_set(root, episodes, **how))
    return check_data_set(data_set, units=units, scene=scene)


def of_kind(report, kind):
    return [moment for moment in report.moments if moment.kind == kind]


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_nothing_is_found_in_a_clean_recording(tmp_path, version):
    report = checked(tmp_path / "set", [swing(), swing(phase=1.0)], version=version)
    assert not report.moments
    assert [note for note in report.notes if "version 3.0" not in note] == []
    assert (report.episodes, report.frames) == (2, 180)
    assert report.differences.lag_s == pytest.approx(0.1)
    assert max(report.differences.rms_deg.values()) < 0.01


def test_droop_is_reported_by_joint(tmp_path):
    action = swing()
    state = late(action)
    state[:, 1] -= 3.0
    report = checked(tmp_path / "set", [(action, state)])
    assert report.differences.mean_deg["shoulder_lift"] == pytest.approx(-3.0, abs=0.05)
    assert report.differences.mean_deg["elbow_flex"] == pytest.approx(0.0, abs=0.05)


def test_a_jump_is_found_where_it_is_and_one_by_a_whole_turn_says_so(tmp_path):
    action = swing()
    action[40:, 0] += 60.0
    report = checked(tmp_path / "set", [swing(), (action, late(swing()))])
    (jump,) = of_kind(report, "jump")
    assert (jump.episode, jump.frame, jump.what, jump.of) == (1, 39, "shoulder_pan", "action")
    assert jump.value == pytest.approx(60.0, abs=2.0)
    assert report.moments[0] is jump
    turned = swing()
    turned[40:, 4] += 360.0
    (jump,) = of_kind(checked(tmp_path / "turned", [turned], with_state=False), "jump")
    assert "about a whole turn" in jump.sentence


def test_speed_is_distinguished_from_a_jump(tmp_path):
    action = swing()
    action[30:40, 0] += np.linspace(0, 63, 10)  # 7 deg a frame, 210 deg/s
    action[40:, 0] += 63
    report = checked(tmp_path / "set", [action])
    assert not of_kind(report, "jump")
    assert {moment.of for moment in of_kind(report, "speed")} == {"action", "state"}


def test_a_joint_beyond_its_travel_is_found(tmp_path):
    action = swing()
    action[20:30, 3] += np.hanning(10) * 80
    report = checked(tmp_path / "set", [action])
    found = of_kind(report, "limit")
    assert {(moment.of, moment.what) for moment in found} == {
        ("action", "wrist_flex"),
        ("state", "wrist_flex"),
    }


def test_contact_with_the_table_and_with_an_obstacle_is_found(tmp_path):
    table = swing()
    table[:, 1:4] = [30, 30, 40]
    report = checked(tmp_path / "set", [swing(), (table, table)])
    found = of_kind(report, "contact")
    assert {moment.episode for moment in found} == {1}
    assert "floor" in found[0].what
    at = SE3.from_translation([0.2, 0, 0.2])
    box = Obstacle(name="crate", shape=Box(size=(0.1, 0.1, 0.3)), T_base_obstacle=at)
    assert not checked(tmp_path / "free", [swing()]).moments
    found = of_kind(checked(tmp_path / "box", [swing()], scene=Scene(obstacles=(box,))), "contact")
    assert "crate" in found[0].sentence


def test_a_joint_that_stands_while_it_is_sent_on_is_found(tmp_path):
    action = swing(200)
    state = late(action)
    state[60:160, 2] = state[60, 2]
    report = checked(tmp_path / "set", [(action, state)])
    (frozen,) = of_kind(report, "frozen")
    assert frozen.what == "elbow_flex"
    assert abs(frozen.first - 60) <= 1
    assert of_kind(report, "not reached")[0].what == "elbow_flex"


def test_a_joint_that_follows_late_does_not_stand(tmp_path):
    pan = np.concatenate([np.zeros(60), np.arange(4, 41, 4), np.full(60, 40.0)])
    action = np.tile([0, -40, 10, 30, 0, 50.0], (len(pan), 1))
    action[:, 0] = pan
    assert not checked(tmp_path / "set", [(action, late(action, 4))]).moments


def test_gaps_in_time_and_in_the_numbers_are_found(tmp_path):
    t = np.arange(90) / 30.0
    t[50:] += 0.4
    numbers = np.arange(90)
    numbers[20:] += 3
    action = swing()
    action[70:75, 2] = np.nan
    report = checked(tmp_path / "set", [action, swing()], timestamps={0: t}, frames={1: numbers})
    times = {(each.episode, each.frame) for each in of_kind(report, "time")}
    assert times == {(0, 49), (1, 19)}
    (missing,) = [each for each in of_kind(report, "missing") if each.of == "action"]
    assert (missing.first, missing.last) == (70, 74)


def test_an_episode_of_another_length_than_its_metadata_says_is_found(tmp_path):
    root = write_data_set(tmp_path / "set", [swing()], version="v2.1", info={"total_frames": 91})
    path = root / "meta/episodes.jsonl"
    path.write_text(path.read_text().replace('"length": 90', '"length": 80'))
    report = check_data_set(open_data_set(root), units="model")
    assert "80" in of_kind(report, "time")[0].sentence
    assert "91 frames; there are 90" in " ".join(report.notes)


def test_the_worst_of_very_many_moments_are_kept_and_the_others_counted(tmp_path):
    action = swing(3000)
    action[::2, 0] += np.linspace(50, 60, 1500)
    report = checked(tmp_path / "set", [action], with_state=False)
    assert report.counts["jump"] == len(of_kind(report, "jump")) == 1
    assert report.moments[0].value > 59.0
    action = swing(9000)
    action[::9, 0] += np.linspace(50, 60, 1000)
    report = checked(tmp_path / "many", [action], with_state=False)
    assert report.counts["jump"] == 1000
    assert len(of_kind(report, "jump")) == 50
    assert report.moments[0].value > 59.0


# What the numbers mean


def in_units(kind, q_deg, calibration=None):
    """Angles with the model's zero in the numbers of a kind; the jaw stays in per cent."""
    return units_of(kind, calibration).from_model(units_of("model").to_model(q_deg))


def rest_and_reach():
    """From a folded arm to a stretched one: what every recording holds."""
    folded, reach = np.array([0, -100, 88, 60, 0, 0]), np.array([40, 60, -60, 20, 90, 90])
    return folded + (reach - folded) * np.linspace(0, 1, 90)[:, None]


@pytest.mark.parametrize("kind", ["degrees", "old"])
def test_what_numbers_mean_is_found_out(tmp_path, kind):
    x = in_units(kind, rest_and_reach())
    report = checked(tmp_path / "set", [x], units="", info={"robot_type": "so_follower"})
    assert report.units.kind == kind
    assert ("before June 2025" in " ".join(report.notes)) == (kind == "old")


def test_numbers_that_are_cut_off_at_100_are_of_a_travel(tmp_path):
    x = np.clip(in_units("range", rest_and_reach()), -100, 100)
    x[0, 1] = -100.0
    assert checked(tmp_path / "set", [x], units="").units.kind == "range"


def counted(scale, offset=0.0):
    """A swing as a servo counts it: ``scale`` numbers a count."""
    return offset + np.round((swing() - offset) / scale) * scale


@pytest.mark.parametrize(
    ("x", "robot", "names", "version", "units", "certainty", "why"),
    [
        (counted(360 / 4095), "so101_follower", NAMES, "v3.0", "degrees", "certain", "counts"),
        (counted(360 / 4096), "my_arm", JOINTS, "v3.0", "old", "certain", "counts"),
        (counted(200 / 2307, -100), "so_follower", NAMES, "v3.0", "range", "certain", "counts"),
        (swing(), "so101_follower", NAMES, "v3.0", "range", "likely", "so101_follower"),
        (np.round(swing()), "bi_so100_follower", NAMES, "v3.0", "range", "likely", "bi_so100"),
        (swing(), "so_follower", NAMES, "v3.0", "degrees", "likely", "so_follower"),
        (swing(), "my_arm", NAMES, "v2.1", "range", "likely", "v2.1"),
        (swing(), "so100", JOINTS, "v2.1", "old", "likely", "June 2025"),
        (swing(), "so100", MAIN, "v3.0", "old", "certain", "main_shoulder_pan"),
        (swing(), "my_arm", NAMES, "v3.0", "degrees", "unknown", "fit degrees as well as"),
        (swing(), "lekiwi", ARM, "v3.0", "degrees", "unknown", "fit degrees as well as"),
    ],
)
def test_units_are_told_from_counts_names_and_releases(
    tmp_path, x, robot, names, version, units, certainty, why
):
    info = {"robot_type": robot}
    how = {"names": names, "version": version, "info": info, "units": ""}
    report = checked(tmp_path / "set", [(x, x)], **how)
    assert (report.units.kind, report.certainty) == (units, certainty)
    assert why in report.why_units
    assert ("give --units" in " ".join(report.notes)) == (certainty != "certain")


def test_no_limit_and_contact_is_found_in_unknown_units(tmp_path):
    down = swing()
    down[:, 1:4] = [40, 40, 40]
    for robot, found in (("so_follower", True), ("my_arm", False)):
        report = checked(tmp_path / robot, [down], units="", info={"robot_type": robot})
        assert bool(of_kind(report, "contact")) == found


def test_numbers_too_small_for_any_units_are_refused_unless_units_are_given(tmp_path):
    x = np.radians(swing())
    with pytest.raises(ConfigError, match="perhaps they are radians"):
        checked(tmp_path / "radians", [x], units="")
    with pytest.raises(ConfigError, match=r"ever beyond 2\.\d+.*perhaps they are radians"):
        checked(tmp_path / "wide", [x * 4], units="")
    assert "radians" in checked(tmp_path / "asked", [x], units="degrees").notes[0]


@pytest.mark.parametrize(("factor", "words"), [(0.01, "0 to 1"), (0.017, "radians"), (3, "hardly")])
def test_a_jaw_in_other_units_is_noticed(tmp_path, factor, words):
    x = swing()
    x[:, 5] = np.linspace(0, 100, 90) * factor
    notes = checked(tmp_path / "set", [x], units="model").notes
    assert "jaw" in notes[0]
    assert words in notes[0]
    assert "scale it to 0 to 100 before" in notes[0]


def test_data_files_that_lerobot_cannot_load_together_are_noticed(tmp_path):
    root = write_data_set(tmp_path / "set", [swing()])
    path = root / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    lists = pa.array(table["action"].to_pylist(), pa.list_(pa.float32()))
    episode = pa.array(np.ones(len(table)), pa.int64())
    other = table.set_column(0, "action", lists).drop(["episode_index"])
    pq.write_table(
        other.append_column("episode_index", episode), path.with_name("file-001.parquet")
    )
    notes = check_data_set(open_data_set(root), units="model").notes
    assert any("LeRobot itself cannot load it" in note for note in notes)


def test_units_that_do_not_fit_are_doubted_and_those_that_do_not_exist_are_refused(tmp_path):
    x = in_units("old", rest_and_reach())
    assert "--units old" in checked(tmp_path / "set", [x], units="degrees").notes[0]
    with pytest.raises(ConfigError, match="degrees, range, old, model"):
        checked(tmp_path / "none", [swing()], units="rad")


def test_without_pyarrow_it_says_what_to_install(tmp_path, monkeypatch):
    root = write_data_set(tmp_path / "set", [swing()])
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigError, match=r"pip install 'so101-motion\[dataset\]'"):
        open_data_set(root)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
@pytest.mark.parametrize("there", [(0, 2), (1, 2), (0, 1)])
def test_an_episode_that_the_metadata_names_and_the_data_lack_is_found(tmp_path, version, there):
    root = write_data_set(tmp_path / "set", [swing()] * 3, version=version)
    (lost,) = {0, 1, 2} - set(there)
    if version == "v2.1":
        (root / f"data/chunk-000/episode_00000{lost}.parquet").unlink()
    else:
        path = root / "data/chunk-000/file-000.parquet"
        table = pq.read_table(path)
        pq.write_table(table.filter(pa.array(table["episode_index"].to_numpy() != lost)), path)
    (moment,) = check_data_set(open_data_set(root), units="model").moments
    assert (moment.kind, moment.sentence) == ("time", f"episode {lost} is missing")
    assert moment.episode in there


@pytest.mark.parametrize("column", ["action", "observation.state"])
def test_one_column_in_radians_is_noticed(tmp_path, column):
    action, state = swing(), late(swing())
    (action if column == "action" else state)[:, :5] *= np.pi / 180.0
    root = write_data_set(tmp_path / "set", [(action, state)])
    with pytest.raises(ConfigError, match=f"{column}: no arm joint .* radians"):
        check_data_set(open_data_set(root))
    notes = check_data_set(open_data_set(root), units="degrees").notes
    (note,) = [note for note in notes if "radians" in note]
    assert note.startswith(column)


def test_videos_that_git_lfs_did_not_download_or_nobody_has_are_noticed(tmp_path):
    root = write_data_set(tmp_path / "set", [swing()], with_camera=True)
    (video,) = root.glob("videos/**/*.mp4")
    video.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 40960\n")
    notes = check_data_set(open_data_set(root), units="model").notes
    assert any("1 files are Git LFS pointers, videos/" in note for note in notes)
    video.unlink()
    notes = check_data_set(open_data_set(root), units="model").notes
    assert any("no videos of" in note and "front" in note for note in notes)
