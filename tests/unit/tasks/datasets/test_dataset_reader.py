import contextlib
import json

import numpy as np
import pytest
from harness.lerobot_data import NAMES, late, pa, pq, swing, vectors, write_data_set

from so101_motion.common.errors import LONGEST_MESSAGE, ConfigError
from so101_motion.tasks.datasets import open_data_set

BOTH = pytest.mark.parametrize("version", ["v2.1", "v3.0"])


@BOTH
def test_episodes_are_read_one_by_one_with_their_joints_in_our_order(tmp_path, version):
    actions = [swing(40), swing(25, phase=1.0), swing(61, phase=2.0)]
    order = [5, 4, 3, 2, 1, 0]
    root = write_data_set(
        tmp_path / "set",
        [(each[:, order], late(each)[:, order]) for each in actions],
        version=version,
        names=[NAMES[i] for i in order],
    )
    found = list(open_data_set(root).episodes())
    assert [each.index for each in found] == [0, 1, 2]
    for each, action in zip(found, actions, strict=True):
        assert np.allclose(each.action, action, atol=1e-4)
        assert np.allclose(each.state, late(action), atol=1e-4)
        assert np.allclose(each.t, np.arange(len(action)) / 30.0, atol=1e-6)
        assert each.expected == len(action)
    assert np.allclose(open_data_set(root).episode(1).action, actions[1], atol=1e-4)


def test_an_episode_longer_than_what_is_read_at_a_time_is_one_episode(tmp_path):
    action = swing(20_000)
    root = write_data_set(tmp_path / "set", [action, swing(10)])
    assert [len(each) for each in open_data_set(root).episodes()] == [20_000, 10]


def test_names_of_older_data_sets_and_of_two_arms_are_known(tmp_path):
    old = {"motors": [f"main_{name.removesuffix('.pos')}" for name in NAMES]}
    root = write_data_set(tmp_path / "old", [swing()], version="v2.1")
    info = json.loads((root / "meta/info.json").read_text())
    info["features"]["action"]["names"] = old
    (root / "meta/info.json").write_text(json.dumps(info))
    assert open_data_set(root).columns["action"] == (0, 1, 2, 3, 4, 5)

    names = [f"{side}_{name}" for side in ("left", "right") for name in NAMES]
    both = np.concatenate([swing(), -swing()], axis=1)
    root = write_data_set(tmp_path / "two", [both], names=names)
    with pytest.raises(ConfigError, match="left or right"):
        open_data_set(root)
    right = open_data_set(root, side="right").episode(0)
    assert np.allclose(right.action, -swing(), atol=1e-4)


def test_a_data_set_without_states_or_jaw_is_read(tmp_path):
    action = swing()[:, :5]
    root = write_data_set(tmp_path / "set", [action], names=NAMES[:5], with_state=False)
    data_set = open_data_set(root)
    assert not data_set.has_state
    assert not data_set.has_jaw
    assert data_set.episode(0).state is None


def test_values_that_are_no_angles_count_as_missing(tmp_path):
    action = swing()
    action[3, 1], action[4, 2], action[5, 0] = np.nan, np.inf, 1e30
    found = open_data_set(write_data_set(tmp_path / "set", [action])).episode(0)
    assert np.argwhere(np.isnan(found.action)).tolist() == [[3, 1], [4, 2], [5, 0]]


@pytest.fixture
def root(tmp_path):
    return write_data_set(tmp_path / "set", [swing(), swing()])


def broken(root):
    with pytest.raises(ConfigError) as caught:
        list(open_data_set(root).episodes())
    assert len(str(caught.value)) < LONGEST_MESSAGE
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"codebase_version": "v1.6"}, "v1.6"),
        ({"codebase_version": 3}, "codebase_version"),
        ({"fps": 0}, "fps"),
        ({"fps": float("nan")}, "fps"),
        ({"fps": True}, "fps"),
        ({"features": []}, "features"),
        ({"features": {"action": 3}}, "action"),
        ({"features": {"observation.state": {"dtype": "float32"}}}, '"action"'),
        ({"features": {"action": {"dtype": "float32", "names": ["x"] * 6}}}, "lacks shoulder_pan"),
        ({"features": {"action": {"dtype": "float32", "names": [1]}}}, "no names"),
        ({"total_frames": -1}, "total_frames"),
        ({"total_frames": "many"}, "total_frames"),
    ],
)
def test_metadata_that_makes_no_sense_is_refused_in_a_sentence(root, change, says):
    info = json.loads((root / "meta/info.json").read_text())
    (root / "meta/info.json").write_text(json.dumps(info | change))
    assert says in broken(root)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "is empty"),
        (b"[" * 100_000, "nested"),
        (b"{" + b" " * 5_000_000 + b"}", "more than"),
        (b"\xff\xfe\x00", "not JSON"),
        (b"[]", "must be an object"),
    ],
)
def test_metadata_that_is_no_metadata_is_refused(root, data, says):
    (root / "meta/info.json").write_bytes(data)
    assert says in broken(root)


def test_a_folder_that_is_no_data_set_is_refused(tmp_path):
    assert "no meta/info.json" in broken(tmp_path)
    assert "is not there" in broken(tmp_path / "nowhere")


def written(root, **columns):
    """The data set with other columns in its only data file."""
    path = root / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    for name, column in columns.items():
        place = table.column_names.index(name)
        table = table.remove_column(place)
        if column is not None:
            table = table.append_column(name, column)
    pq.write_table(table, path)
    return root


N = 180


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"action": None}, 'no column "action"'),
        ({"timestamp": None}, 'no column "timestamp"'),
        ({"action": pa.array(["x"] * N)}, "lists of numbers"),
        ({"action": vectors(np.zeros((N, 5)))}, "6 numbers"),
        ({"action": pa.array([[0.0] * (6 - k % 2) for k in range(N)])}, "numbers"),
        ({"action": pa.array([["x"] * 6] * N)}, "lists of numbers"),
        ({"action": pa.array([None] + [[0.0] * 6] * (N - 1))}, "empty in some rows"),
        ({"timestamp": pa.array(["now"] * N)}, "must hold numbers"),
        ({"episode_index": pa.array([0.5] * N)}, "whole number"),
        ({"episode_index": pa.array([-1] * N)}, "whole number"),
        ({"episode_index": pa.array([0, 1] * (N // 2))}, "not in one piece"),
        ({"action": pa.array([[0.0] * 60] * N)}, "6 numbers"),
    ],
)
def test_data_that_is_something_else_is_refused_in_a_sentence(root, columns, says):
    assert says in broken(written(root, **columns))


def test_a_file_that_announces_more_than_any_data_set_is_refused_before_it_is_read(tmp_path):
    root = write_data_set(tmp_path / "set", [swing(10)])
    path = root / "data/chunk-000/file-000.parquet"
    many = 21_000_000
    numbers = pa.array(np.zeros(many, np.int8))
    with pq.ParquetWriter(path, pa.schema([("episode_index", pa.int8())])) as writer:
        writer.write_table(pa.table({"episode_index": numbers}))
    assert f"declares {many} rows" in broken(root)


def test_a_file_that_is_not_there_not_finished_or_not_downloaded_is_named(root):
    path = root / "data/chunk-000/file-000.parquet"
    path.write_bytes(path.read_bytes()[:-8])
    assert "finalize" in broken(root)
    path.write_text("version https://git-lfs.github.com/spec/v1\nsize 40960\n")
    assert "git lfs pull" in broken(root)
    path.unlink()
    assert "no data files" in broken(root)
    path.write_bytes(b"PAR1 nothing else PAR1")
    assert "not a readable Parquet file" in broken(root)


def test_a_broken_footer_does_not_end_the_process(tmp_path):
    root = write_data_set(tmp_path / "set", [swing(30), swing(20)])
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    whole = path.read_bytes()
    for place in range(-2960, -2880):  # pyarrow 26 aborts at -2922 when asked for a column's sizes
        path.write_bytes(whole[:place] + b"\0" + whole[place + 1 :])
        with contextlib.suppress(ConfigError):
            list(open_data_set(root).episodes())


@pytest.mark.parametrize("robot", ["koch_follower", "bi_openarm_follower", "moss"])
def test_other_arms_with_these_joint_names_are_refused(tmp_path, robot):
    root = write_data_set(tmp_path / "set", [swing()], info={"robot_type": robot})
    with pytest.raises(ConfigError, match="not an SO-101"):
        open_data_set(root)


def test_the_names_of_mobile_robots_are_read(tmp_path):
    names = [f"{side}_arm_{name}" for side in ("left", "right") for name in NAMES] + ["x.vel"]
    x = np.hstack([swing(), swing() + 1.0, np.zeros((90, 1))])
    root = write_data_set(tmp_path / "set", [x], names=names, info={"robot_type": "xlerobot"})
    right = open_data_set(root, side="right").episode(0).action
    assert right == pytest.approx(swing() + 1.0, abs=1e-4)
