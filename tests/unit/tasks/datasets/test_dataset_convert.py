import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from harness.command_line import refused
from harness.lerobot_data import CAMERA, NAMES, late, pq, swing, write_data_set
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.calib.record.zero import by_stops, expected_travel, zero_ticks
from so101_motion.common.errors import ConfigError
from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.tasks.datasets import check_data_set, convert_data_set, open_data_set, units_of
from so101_motion.tasks.datasets.units import KINDS

TENTH = np.radians(0.1)
MODEL = units_of("model")


def swept(joint, place, shift, excess, turned):
    """A joint whose travel was recorded from stop to stop, but for a little."""
    if joint == "wrist_roll":
        return JointCalibration(id=place, range_min=0, range_max=4095, drive_mode=turned)
    width = round(expected_travel(joint)) + excess
    lower = min(max(2048 - width // 2 + shift, 0), 4095 - width)
    return JointCalibration(id=place, range_min=lower, range_max=lower + width, drive_mode=turned)


@st.composite
def calibrations(draw):
    numbers = partial(st.integers, -30, 30)
    entries = {
        joint: swept(joint, place, draw(numbers()), draw(numbers()), draw(st.sampled_from([0, 1])))
        for place, joint in enumerate(JOINTS, start=1)
    }
    return store.Stored(path=Path("arm.json"), calibration=entries, zeros={}, notes=())


arm_angles = st.lists(st.floats(-85, 85), min_size=5, max_size=5)
kinds = st.sampled_from(KINDS)


@given(calibrations(), calibrations(), kinds, kinds, arm_angles, st.floats(0, 100))
def test_there_and_back_is_the_same_within_a_tenth_of_a_degree(a, b, first, second, q_deg, jaw):
    here, there = units_of(first, a), units_of(second, b)
    q = np.append(np.radians(q_deg), np.radians(jaw))
    x = np.float32(here.from_model(q))  # as it is stored
    y = np.float32(there.from_model(here.to_model(x)))
    back = np.float32(here.from_model(there.to_model(y)))
    assert np.abs(here.to_model(back) - q).max() <= TENTH
    assert np.abs(there.to_model(y) - q).max() <= TENTH


def lerobots_ticks(x, entry, kind):
    """Where LeRobot 0.6.1 sends a servo for the number ``x`` (``_unnormalize`` of its bus)."""
    low, high = entry.range_min, entry.range_max
    if kind == "degrees":
        return x * 4095 / 360 + (low + high) / 2
    x = -x if entry.drive_mode else x
    return (x + 100) / 200 * (high - low) + low


@given(calibrations(), calibrations(), st.sampled_from(["degrees", "range"]), arm_angles)
def test_lerobot_sends_both_arms_to_the_same_angles(a, b, kind, q_deg):
    q = np.append(np.radians(q_deg), 0.0)
    x = units_of(kind, a).from_model(q)
    y = units_of(kind, b).from_model(units_of(kind, a).to_model(x))
    for i, joint in enumerate(JOINTS[:5]):
        for number, stored in ((x[i], a), (y[i], b)):
            entry = stored.calibration[joint]
            zero = by_stops(joint, entry) or store.Zero(by="middle", angle=0.0)
            off = lerobots_ticks(number, entry, kind) - zero_ticks(entry, zero)
            angle = (-1 if entry.drive_mode else 1) * off * RAD_PER_TICK
            assert angle == pytest.approx(q[i], abs=TENTH)


def stored(tmp_path, name="arm.json", *, shift=0, excess=0):
    entries = {
        joint: swept(joint, place, shift, excess, 0) for place, joint in enumerate(JOINTS, start=1)
    }
    return store.save(tmp_path / name, entries)


def numbers_of(data_set):
    episodes = list(data_set.episodes())
    return [each.action for each in episodes], [each.state for each in episodes]


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_data_set_is_written_anew_with_other_numbers_and_statistics(tmp_path, version):
    root = write_data_set(
        tmp_path / "old", [swing(), swing(50, phase=2.0)], version=version, with_camera=True
    )
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    source, target = units_of("degrees", stored(tmp_path)), units_of("range", stored(tmp_path))
    data_set = open_data_set(root)
    done = convert_data_set(data_set, tmp_path / "new", source=source, target=target)
    assert (done.episodes, done.frames) == (2, 140)
    assert not any(done.beyond.values())
    assert before == {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}

    new = open_data_set(tmp_path / "new")
    for was, now in zip(numbers_of(data_set), numbers_of(new), strict=True):
        for x, y in zip(was, now, strict=True):
            assert np.allclose(source.to_model(x), target.to_model(y), atol=1e-5)
            assert np.allclose(x[:, 5], y[:, 5], atol=1e-4)
    assert check_data_set(new).why_units == "declared in meta/so101_units.json"

    here, there = ({p.relative_to(r) for p in r.rglob("*")} for r in (root, tmp_path / "new"))
    ours = ("units", "calibration", "calibration.zero")
    assert there - here == {Path(f"meta/so101_{name}.json") for name in ours}
    declared = new.calibration
    assert declared.calibration == target.calibration.calibration
    assert declared.zeros == target.calibration.zeros
    assert not here - there
    action = np.concatenate(numbers_of(new)[0])
    stats = json.loads((tmp_path / "new/meta/stats.json").read_text())
    assert stats["action"] == {"mean": pytest.approx(action.mean(axis=0), abs=1e-4)}
    first = numbers_of(new)[0][0]
    assert mean_of_first(tmp_path / "new", version) == pytest.approx(first.mean(axis=0), abs=1e-4)


def test_what_an_arm_took_of_its_actions_is_converted_as_well(tmp_path):
    names = (*NAMES, *(f"{joint}.taken" for joint in JOINTS))
    rows = np.hstack([swing(), swing(phase=1.0)])
    root = write_data_set(tmp_path / "old", [(rows, rows)], names=names)
    source, target = units_of("degrees", stored(tmp_path)), units_of("range", stored(tmp_path))
    convert_data_set(open_data_set(root), tmp_path / "new", source=source, target=target)
    table = pq.read_table(tmp_path / "new/data/chunk-000/file-000.parquet")
    new = np.array(table.column("observation.state").to_pylist())
    for begin in (0, 6):
        before, after = rows[:, begin : begin + 6], new[:, begin : begin + 6]
        assert np.allclose(source.to_model(before), target.to_model(after), atol=1e-5)


def mean_of_first(root, version):
    if version == "v3.0":
        table = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet")
        assert table.column("tasks").to_pylist() == [["wave"], ["wave"]]
        return table.column("stats/action/mean").to_pylist()[0]
    lines = (root / "meta/episodes_stats.jsonl").read_text().splitlines()
    return json.loads(lines[0])["stats"]["action"]["mean"]


def test_statistics_of_all_episodes_are_those_of_all_frames(tmp_path):
    root = write_data_set(tmp_path / "old", [swing(), swing(50, phase=2.0)])
    names = ["min", "max", "mean", "std", "count", "q50", "unknown"]
    (root / "meta/stats.json").write_text(json.dumps({"action": {key: [0.0] for key in names}}))
    convert_data_set(open_data_set(root), tmp_path / "new", source=MODEL, target=MODEL)
    found = json.loads((tmp_path / "new/meta/stats.json").read_text())["action"]
    x = np.concatenate([swing(), swing(50, phase=2.0)])
    assert found["std"] == pytest.approx(x.std(axis=0), abs=1e-3)
    assert found["min"] == pytest.approx(x.min(axis=0), abs=1e-3)
    assert found["count"] == [140]
    assert "unknown" not in found


def test_what_is_beyond_the_new_travel_is_kept_and_counted(tmp_path):
    action = swing()
    action[:7, 3] = 110.0
    root = write_data_set(tmp_path / "old", [(action, late(action, 0))])
    narrow = units_of("range", stored(tmp_path))
    done = convert_data_set(open_data_set(root), tmp_path / "new", source=MODEL, target=narrow)
    assert {joint: n for joint, n in done.beyond.items() if n} == {"wrist_flex": 7}
    found = open_data_set(tmp_path / "new").episode(0).action
    assert np.degrees(narrow.to_model(found)[0, 3]) == pytest.approx(110.0, abs=0.01)


def test_linked_files_are_the_same_files(tmp_path):
    root = write_data_set(tmp_path / "old", [swing()], with_camera=True)
    convert_data_set(open_data_set(root), tmp_path / "new", source=MODEL, target=MODEL, link=True)
    video = Path("videos") / CAMERA / "chunk-000" / "file-000.mp4"
    assert (root / video).samefile(tmp_path / "new" / video)
    assert not (root / "meta/info.json").samefile(tmp_path / "new/meta/info.json")


@pytest.mark.parametrize("place", ["old", "old/new", ".", "there", "nowhere/new"])
def test_a_place_that_would_lose_something_is_refused(tmp_path, place):
    root = write_data_set(tmp_path / "old", [swing()])
    (tmp_path / "there").mkdir()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ConfigError):
        convert_data_set(open_data_set(root), tmp_path / place, source=MODEL, target=MODEL)
    assert sorted(tmp_path.rglob("*")) == before


def test_nothing_is_left_of_a_conversion_that_fails(tmp_path):
    root = write_data_set(tmp_path / "old", [swing(), swing()], version="v2.1")
    path = root / "data/chunk-000/episode_000001.parquet"
    path.write_bytes(path.read_bytes()[:-3] + b"???")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ConfigError, match="has no footer"):
        convert_data_set(open_data_set(root), tmp_path / "new", source=MODEL, target=MODEL)
    assert sorted(tmp_path.rglob("*")) == before


def test_each_arm_of_two_is_converted_and_declared_alone_and_a_contradiction_is_refused(tmp_path):
    names = [f"{side}_{name}" for side in ("left", "right") for name in NAMES]
    both = np.hstack([swing(), swing(phase=1.0)])
    root = write_data_set(tmp_path / "two", [both], names=names)
    old = units_of("old")
    convert_data_set(open_data_set(root, side="left"), tmp_path / "one", source=old, target=MODEL)
    left, right = (open_data_set(tmp_path / "one", side=side) for side in ("left", "right"))
    assert (left.declared, right.declared) == ("model", "")
    assert np.allclose(right.episode(0).action, swing(phase=1.0), atol=1e-4)
    found = MODEL.to_model(left.episode(0).action)
    assert np.allclose(found, old.to_model(swing()), atol=1e-5)
    with pytest.raises(ConfigError, match="declares model"):
        convert_data_set(left, tmp_path / "twice", source=old, target=MODEL)
    assert any("contradicts" in note for note in check_data_set(left, units="old").notes)
    convert_data_set(right, tmp_path / "both", source=old, target=old)
    sides = [open_data_set(tmp_path / "both", side=side).declared for side in ("left", "right")]
    assert sides == ["model", "old"]


def test_the_command_converts_between_two_arms(so101, tmp_path):
    root = write_data_set(tmp_path / "old", [swing()])
    a, b = stored(tmp_path), stored(tmp_path, "b.json", shift=40, excess=20)
    files = (root, tmp_path / "new", "--calibration", a.path, "--to-calibration", b.path)
    result = so101("dataset convert --units range --json", *files)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["frames"] == 90
    assert "middle of the travel is used as zero of wrist_roll" in result.stderr
    found = open_data_set(tmp_path / "new").episode(0).action
    q, now = units_of("range", a).to_model(swing()), units_of("range", b).to_model(found)
    assert np.allclose(q[:, :5], now[:, :5], atol=1e-4)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("", "give --units"),
        ("--units range", "calibration"),
        ("--units old --to degrees", "to-calibration"),
    ],
)
def test_what_cannot_be_exact_is_not_converted(so101, tmp_path, options, says):
    root = write_data_set(tmp_path / "old", [swing()])
    assert says in refused(so101(f"dataset convert {options}", root, tmp_path / "new"))
    assert not (tmp_path / "new").exists()
