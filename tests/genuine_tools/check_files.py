"""Read the files of other programs: the bounds, volume and surface of one part, or a message.

The part is an L of 40 x 30 x 20 mm with a notch, at x = 200 mm; clouds are points of its surface.
At 400 configurations, half of them in contact, the arm must touch all meshes alike.
"""

import json
import sys
from pathlib import Path

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.files.scene_file import obstacles_from
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Obstacle, Scene
from so101_motion.planning.collision.shape_files import read_cloud
from so101_motion.planning.kinematics.model import RobotModel

MODEL = RobotModel.load()
LOWER, UPPER = np.array([0.2, 0.0, 0.0]), np.array([0.24, 0.03, 0.02])


def verdict(path):
    kind = path.suffix[1:]
    try:
        if kind in ("pcd", "xyz") or "cloud" in path.name:
            points = read_cloud(kind, path.read_bytes())
            is_right = len(points) == 500 and np.all(
                (points > LOWER - 1e-6) & (points < UPPER + 1e-6)
            )
            return "right" if is_right else f"WRONG {len(points)} points"
        entry = {"name": "part", "mesh_file": str(path)}
        try:
            mesh = obstacles_from([entry])[0].shape
            by = "right"
        except ConfigError as error:
            if "scale" not in error.reason:
                raise
            number = error.reason.split('"scale": ')[1]
            mesh = obstacles_from([entry | {"scale": float(number.split()[0])}])[0].shape
            by = f"right with scale {float(number.split()[0]):g}"
    except ConfigError as error:
        return f"refused: {error.reason}"
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    volume = abs(np.sum(a * np.cross(b, c))) / 6.0 * 1e9
    surface = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0 * 1e6
    bounds = np.r_[mesh.vertices.min(axis=0) - LOWER, mesh.vertices.max(axis=0) - UPPER]
    if np.abs(bounds).max() > 1e-5 or abs(volume - 12e3) > 2.0 or abs(surface - 4e3) > 2.0:
        return f"WRONG off by {1e3 * bounds} mm, {volume:.0f} mm3, {surface:.0f} mm2"
    return by + touched(mesh)


def touched(mesh):
    """What is wrong about the contacts with a mesh, compared with the first one; mostly nothing."""
    part = Obstacle(name="part", shape=mesh, T_base_obstacle=SE3.identity())
    touching = CollisionModel(MODEL, Scene(obstacles=(part,), floor_z=None)).touching
    if not AT:
        q = np.random.default_rng(0).uniform(MODEL.lower, MODEL.upper, (40_000, 5))
        hits = touching(q)
        AT.append(np.concatenate([q[hits][:200], q[~hits][:200]]))
    found = touching(AT[0])
    off = int((found != (np.arange(len(found)) < 200)).sum())
    return f", but WRONG at {off} of {len(found)} configurations" if off else ", touched alike"


AT = []
found = {path.name: verdict(path) for path in sorted(Path(sys.argv[1]).iterdir())}
text = json.dumps(found, indent=1)
Path(sys.argv[2]).write_text(text + "\n", encoding="utf-8")
print(text)
sys.exit(any("WRONG" in each for each in found.values()))
