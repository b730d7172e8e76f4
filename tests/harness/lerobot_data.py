"""LeRobot data sets of an SO-101, small, in the layouts of versions 2.1 and 3."""

import json

import numpy as np
import pytest

from so101_motion.calib.record.record import JOINTS

pa = pytest.importorskip("pyarrow")  # an environment of before the extra has none
pq = pytest.importorskip("pyarrow.parquet")

NAMES = tuple(f"{joint}.pos" for joint in JOINTS)

CAMERA = "observation.images.front"


def swing(n=90, fps=30.0, *, phase=0.0):
    """An action of ``n`` frames that swings gently above the table, shape (n, 6), in degrees."""
    t = np.arange(n) / fps
    middle, amount = np.array([0, -40, 10, 30, 0, 50]), np.array([20, 10, 10, 10, 30, 40])
    return middle + amount * np.sin(np.outer(t, [0.9, 0.7, 0.8, 1.1, 1.3, 0.6]) + phase)


def late(action, frames=3):
    """The state that follows an action some frames later."""
    return np.concatenate([np.repeat(action[:1], frames, axis=0), action])[: len(action)]


def write_data_set(
    root,
    episodes,
    *,
    version="v3.0",
    fps=30.0,
    names=NAMES,
    with_state=True,
    with_camera=False,
    timestamps=None,
    frames=None,
    info=None,
):
    """Write a data set and return its folder.

    ``episodes`` are actions of shape (n, len(names)), or pairs of action and state; ``timestamps``
    and ``frames`` are other than regular ones, by episode; ``info`` is what ``info.json`` says
    besides.
    """
    keys = ("action", "observation.state") if with_state else ("action",)
    features = {
        key: {"dtype": "float32", "shape": [len(names)], "names": list(names)} for key in keys
    }
    if with_camera:
        features[CAMERA] = {"dtype": "video", "shape": [48, 64, 3], "names": None}
    for key in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
        dtype = "float32" if key == "timestamp" else "int64"
        features[key] = {"dtype": dtype, "shape": [1], "names": None}
    tables, rows = [], []
    begin = 0
    for number, episode in enumerate(episodes):
        action, state = episode if isinstance(episode, tuple) else (episode, late(episode))
        n = len(action)
        t = (timestamps or {}).get(number, np.arange(n) / fps)
        frame = (frames or {}).get(number, np.arange(n))
        columns = {"action": vectors(action), "observation.state": vectors(state)}
        columns = {key: columns[key] for key in keys} | {
            "timestamp": pa.array(t, pa.float32()),
            "frame_index": pa.array(frame, pa.int64()),
            "episode_index": pa.array(np.full(n, number), pa.int64()),
            "index": pa.array(begin + np.arange(n), pa.int64()),
            "task_index": pa.array(np.zeros(n), pa.int64()),
        }
        tables.append(pa.table(columns))
        rows.append({"episode_index": number, "tasks": ["wave"], "length": n})
        begin += n
    v3 = version.startswith("v3")
    (root / "meta").mkdir(parents=True)
    content = {
        "codebase_version": version,
        "robot_type": "so101_follower",
        "fps": fps,
        "total_episodes": len(episodes),
        "total_frames": begin,
        "total_tasks": 1,
        "chunks_size": 1000,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
        if v3
        else "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": None,
        "features": features,
    }
    (root / "meta/info.json").write_text(json.dumps(content | (info or {})))
    (root / "meta/stats.json").write_text(json.dumps({key: {"mean": [0.0]} for key in keys}))
    data = root / "data" / "chunk-000"
    data.mkdir(parents=True)
    if v3:
        with pq.ParquetWriter(data / "file-000.parquet", tables[0].schema) as writer:
            for table in tables:
                writer.write_table(table)
        _write_v3(root, rows, keys, with_camera)
    else:
        for number, table in enumerate(tables):
            pq.write_table(table, data / f"episode_{number:06d}.parquet")
        _write_v2(root, rows, keys, with_camera)
    return root


def vectors(values):
    """Rows of numbers as LeRobot has them: lists of fixed size, 32 bit."""
    values = np.asarray(values, dtype=np.float32)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _write_v3(root, rows, keys, with_camera):
    folder = root / "meta/episodes/chunk-000"
    folder.mkdir(parents=True)
    begin = np.cumsum([0, *(row["length"] for row in rows)])
    for k, row in enumerate(rows):
        row |= {
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": int(begin[k]),
            "dataset_to_index": int(begin[k + 1]),
        }
        row |= {f"stats/{key}/mean": [0.0] * 6 for key in keys}
        row |= {f"stats/{key}/count": [row["length"]] for key in keys}
    pq.write_table(pa.Table.from_pylist(rows), folder / "file-000.parquet")
    tasks = pa.table({"task_index": pa.array([0], pa.int64()), "task": ["wave"]})
    pq.write_table(tasks, root / "meta/tasks.parquet")
    if with_camera:
        video = root / "videos" / CAMERA / "chunk-000" / "file-000.mp4"
        video.parent.mkdir(parents=True)
        video.write_bytes(b"no real video")


def _write_v2(root, rows, keys, with_camera):
    lines = {
        "episodes.jsonl": rows,
        "tasks.jsonl": [{"task_index": 0, "task": "wave"}],
        "episodes_stats.jsonl": [
            {
                "episode_index": row["episode_index"],
                "stats": {key: {"mean": [0.0] * 6, "count": [row["length"]]} for key in keys},
            }
            for row in rows
        ],
    }
    for name, content in lines.items():
        (root / "meta" / name).write_text("".join(json.dumps(row) + "\n" for row in content))
    if with_camera:
        for row in rows:
            number = row["episode_index"]
            video = root / "videos" / "chunk-000" / CAMERA / f"episode_{number:06d}.mp4"
            video.parent.mkdir(parents=True, exist_ok=True)
            video.write_bytes(b"no real video")
