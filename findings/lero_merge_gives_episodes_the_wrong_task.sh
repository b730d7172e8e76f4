#!/bin/sh
# lero-core 0.3.0, an editor of LeRobot data sets of version 2.1: --merge and --delete.
#
# Expected: two sets joined keep each episode's task, and the joined set is one of version 2.1 again. A set
# without its first episode is renumbered throughout.
# Seen: rows of the second set keep their task_index, which in the joined list of tasks is the first set's task:
# a policy that is told "wave" is trained on "nod" as well. The global index starts again at 0, info.json says version 0.1.0 and
# names no feature (so no joint), and there are no statistics. --delete of a set without videos ends in an error after
# the first file is gone: rows keep their old episode_index, and episode 0 has the statistics of the deleted one.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet lero-core==0.3.0 pyarrow==25.0.0 "numpy<3"
cat > check.py <<'PY'
import json
import pathlib
import subprocess

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
NUMBERS = ("frame_index", "episode_index", "index", "task_index")


def write(name, lengths, task):
    """A small set as LeRobot 0.3.3 lays it out."""
    meta, data = pathlib.Path(name, "meta"), pathlib.Path(name, "data/chunk-000")
    meta.mkdir(parents=True)
    data.mkdir(parents=True)
    vector = {"dtype": "float32", "shape": [6], "names": [f"{joint}.pos" for joint in JOINTS]}
    features = {"action": vector, "observation.state": vector}
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    features |= {key: {"dtype": "int64", "shape": [1], "names": None} for key in NUMBERS}
    info = {
        "codebase_version": "v2.1", "robot_type": "so101_follower", "fps": 30,
        "total_episodes": len(lengths), "total_frames": sum(lengths), "total_tasks": 1,
        "total_videos": 0, "total_chunks": 1, "chunks_size": 1000,
        "splits": {"train": f"0:{len(lengths)}"}, "video_path": None, "features": features,
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
    }
    (meta / "info.json").write_text(json.dumps(info))
    (meta / "tasks.jsonl").write_text(json.dumps({"task_index": 0, "task": task}) + "\n")
    episodes, stats, first = [], [], 0
    for episode, n in enumerate(lengths):
        q = np.linspace(0.0, 10.0 * (episode + 1), 6 * n, dtype="float32").reshape(n, 6)
        columns = {key: pa.FixedSizeListArray.from_arrays(pa.array(q.ravel()), 6) for key in ("action", "observation.state")}
        columns["timestamp"] = pa.array(np.arange(n) / 30.0, pa.float32())
        rows = (range(n), [episode] * n, range(first, first + n), [0] * n)
        columns |= {key: pa.array(each) for key, each in zip(NUMBERS, rows)}
        pq.write_table(pa.table(columns), data / f"episode_{episode:06d}.parquet")
        first += n
        episodes.append(json.dumps({"episode_index": episode, "tasks": [task], "length": n}))
        of = {"min": q.min(0).tolist(), "max": q.max(0).tolist(), "mean": q.mean(0).tolist(), "std": q.std(0).tolist(), "count": [n]}
        stats.append(json.dumps({"episode_index": episode, "stats": {"action": of, "observation.state": of}}))
    (meta / "episodes.jsonl").write_text("\n".join(episodes) + "\n")
    (meta / "episodes_stats.jsonl").write_text("\n".join(stats) + "\n")


def rows(name):
    files = sorted(pathlib.Path(name).glob("data/*/*.parquet"))
    return [pq.read_table(each).slice(0, 1).select(NUMBERS[1:]).to_pylist()[0] for each in files]


def lines(path):
    return [json.loads(each) for each in pathlib.Path(path).read_text().splitlines()]


write("waving", (10, 20), "wave")
write("nodding", (5, 5), "nod")
subprocess.run(["venv/bin/lero", "waving", "--merge", "waving", "nodding", "--output", "both"], check=True, stdout=-1)
print("tasks:", [(each["task_index"], each["task"]) for each in lines("both/meta/tasks.jsonl")])
print("first row of each episode:", *rows("both"), sep="\n  ")
info = json.loads(pathlib.Path("both/meta/info.json").read_text())
print("info.json:", info)
assert [each["task_index"] for each in rows("both")] == [0, 0, 0, 0]  # 0, 0, 1, 1 would be right
assert [each["index"] for each in rows("both")] == [0, 10, 0, 5]
assert info["codebase_version"] == "0.1.0" and info["features"] == {}
assert not pathlib.Path("both/meta/episodes_stats.jsonl").exists()

done = subprocess.run(["venv/bin/lero", "waving", "--delete", "0"], stdout=-1, stderr=subprocess.STDOUT, text=True)
print(done.stdout.strip().splitlines()[-1])
print("rows of what is episode 0 now:", rows("waving")[0])
assert rows("waving")[0]["episode_index"] == 1
assert [each["stats"]["action"]["count"] for each in lines("waving/meta/episodes_stats.jsonl")] == [[10], [20]]
PY
venv/bin/python check.py
