"""Data sets of version 3 without their pictures; like LeRobot's, they are whole once finalized."""

import json
import shutil
from pathlib import Path

import numpy as np
from harness.lerobot_data import write_data_set


class LeRobotDataset:
    def __init__(self, root, fps, features, robot_type, episodes):
        self.root, self._fps, self._features = Path(root), fps, features
        self._robot, self._episodes, self._frames = robot_type, episodes, []

    @classmethod
    def create(cls, repo_id, fps, features, root=None, robot_type=None, image_writer_threads=0):
        Path(root).mkdir(parents=True)
        return cls(root, fps, features, robot_type, [])

    @classmethod
    def resume(cls, repo_id, root=None, image_writer_threads=0):
        info = json.loads((Path(root) / "meta/info.json").read_text())
        known = json.loads((Path(root) / "episodes.json").read_text())
        return cls(root, info["fps"], info["features"], info["robot_type"], known)

    def add_frame(self, frame):
        assert frame.keys() == {*self._features, "task"}, frame.keys()
        for key, feature in self._features.items():
            assert frame[key].shape == tuple(feature["shape"])
        self._frames.append(frame)

    def save_episode(self):
        action, state = (
            np.array([frame[key] for frame in self._frames]).tolist()
            for key in ("action", "observation.state")
        )
        self._episodes.append((action, state))
        self._frames = []

    def clear_episode_buffer(self):
        self._frames = []

    def finalize(self):
        if not self._episodes:
            return
        shutil.rmtree(self.root)
        episodes = [(np.array(action), np.array(state)) for action, state in self._episodes]
        info = {"robot_type": self._robot, "features": self._features}
        write_data_set(self.root, episodes, fps=self._fps, info=info)
        (self.root / "episodes.json").write_text(json.dumps(self._episodes))
