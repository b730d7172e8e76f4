"""One block as a box, as meshes and as a cloud: verdicts, depths, ways out; jogs in what is open.

The block is placed at random around the arm. Its meshes have 12 and 12,288 triangles; its cloud has
points in every cube of its surface. For jogs a side is missing, or only what one camera sees is
there, as a mesh or a cloud with noise; how much deeper a jog of one second leads is measured in the
closed block.

    python -m benchmarks.bench_solids --placements 1000 --jogs 500
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import trimesh

from benchmarks import _common
from so101_motion.common.errors import InCollision
from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Box, Mesh, Obstacle, PointCloud, Scene, Shape
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.differential.targets import Twist
from so101_motion.planning.goals import LeaveContactGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.paths.start_recovery import find_departure
from so101_motion.planning.timing.limits import MotionLimits

MODEL = RobotModel.load()
LIMITS = MotionLimits.uniform(velocity=1.0, acceleration=4.0, jerk=60.0)
CELL = 0.01
PER_BLOCK = 20


def around(shape: Shape, T: SE3) -> CollisionModel:
    """The arm with a block, without a floor."""
    block = Obstacle(name="block", shape=shape, T_base_obstacle=T)
    return CollisionModel(MODEL, Scene(obstacles=(block,), floor_z=None))


def mesh(of: Any) -> Mesh:
    """A mesh of trimesh's."""
    return Mesh(vertices=np.array(of.vertices), triangles=np.array(of.faces))


def turned(random: np.random.Generator) -> Array:
    """A random rotation."""
    R = np.linalg.qr(random.standard_normal((3, 3)))[0]
    return np.asarray(R * np.linalg.det(R))


def forms(size: Array) -> dict[str, Shape]:
    """The block in its forms."""
    coarse = trimesh.creation.box(extents=size)
    fine = coarse
    for _ in range(5):
        fine = fine.subdivide()
    axes = [(np.arange(round(each / CELL)) + 0.5) * CELL - each / 2 for each in size]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    shell = (np.abs(np.abs(grid) - (size / 2 - CELL / 2)) < 1e-6).any(axis=1)
    cloud = PointCloud(points=grid[shell], resolution=CELL)
    return {"mesh 12": mesh(coarse), "mesh 12288": mesh(fine), "cloud": cloud}


def way_out(collision: CollisionModel, q: Array) -> Array | None:
    """The end of the way out; None if there is none."""
    farthest = LeaveContactGoal().farthest
    try:
        return find_departure(MODEL, collision, q, q_jaw=0.0, towards=(), seed=0, farthest=farthest)
    except InCollision:
        return None


def placements(count: int, random: np.random.Generator) -> dict[str, Any]:
    """How the forms compare with the box."""
    row: dict[str, Any] = {"what": "forms of a block against the box", "placements": count}
    row |= {"in contact": 0, "deepest [mm]": 0.0, "left by the box": 0}
    other = {"verdicts": 0, "ways out": 0, "depth, worst [mm]": 0.0}
    found = {name: dict(other) for name in ("mesh 12", "mesh 12288", "cloud")}
    for _ in range(count // PER_BLOCK):
        size = 2.0 * CELL * np.asarray(random.integers(2, 11, 3), dtype=np.float64)
        near = random.uniform(MODEL.lower, MODEL.upper)
        T = SE3(turned(random), MODEL.frame(near).p)
        box = around(Box(size=size), T)
        others = {name: around(shape, T) for name, shape in forms(size).items()}
        for q in near + 0.4 * random.standard_normal((PER_BLOCK, 5)):
            q = np.clip(q, MODEL.lower, MODEL.upper)
            free, distance = box.is_free(q), box.distances(q)
            ours = np.array([second == "block" for _, second in box.pairs])
            deep = bool((distance[ours] < 0.0).any())
            end = way_out(box, q) if deep else None
            row["in contact"] += deep
            row["left by the box"] += end is not None
            row["deepest [mm]"] = max(row["deepest [mm]"], -1e3 * float(distance[ours].min()))
            for name, each in others.items():
                this = found[name]
                this["verdicts"] += each.is_free(q) != free
                if deep:
                    off = 1e3 * float(np.abs(each.distances(q) - distance).max())
                    this["depth, worst [mm]"] = max(this["depth, worst [mm]"], off)
                    to = way_out(each, q)
                    same = to is end if to is None or end is None else np.allclose(to, end)
                    this["ways out"] += not same
    differs = {
        f"{name}: {key}": value for name, each in found.items() for key, value in each.items()
    }
    return row | differs


def open_form(size: Array, T: SE3, random: np.random.Generator) -> tuple[str, Shape] | None:
    """A block without a side, or what a camera somewhere above sees of it."""
    block = trimesh.creation.box(extents=size)
    for _ in range(int(random.integers(4))):
        block = block.subdivide()
    kind = random.choice(["without a side", "seen", "cloud", "noisy cloud"])
    if kind == "without a side":
        side = random.choice([-1, 1]) * np.eye(3)[random.integers(3)]
        kept = block.face_normals @ side < 0.9
    else:
        camera = T.p + random.standard_normal(3) * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.5]
        towards = (T.inverse @ camera) - block.triangles_center
        kept = np.einsum("ij,ij->i", block.face_normals, towards) > 0.0
    if not kept.any():
        return None
    block.update_faces(kept)
    if "cloud" not in kind:
        return kind, mesh(block)
    points, _ = trimesh.sample.sample_surface(block, int(6 * block.area / CELL**2), seed=1)
    if kind == "noisy cloud":
        points = points + 0.001 * random.standard_normal(points.shape)
    return kind, PointCloud(points=np.array(points), resolution=CELL)


def jogs(count: int, random: np.random.Generator) -> dict[str, Any]:
    """How much deeper jogs lead into a block of which a part is known."""
    deeper, moved, kinds = list[float](), 0, dict[str, int]()
    while len(deeper) < count:
        q, size = random.uniform(MODEL.lower, MODEL.upper), random.uniform(0.02, 0.25, 3)
        T = SE3(turned(random), MODEL.frame(q).p + random.uniform(-0.15, 0.15, 3))
        form = open_form(size, T, random)
        if form is None:
            continue
        collision = around(form[1], T)
        distance = collision.distances(q)
        ours = np.array([second == "block" for _, second in collision.pairs])
        if not (distance[ours] <= 0.0).any() or (distance[~ours] < 0.005).any():
            continue
        closed, servo = around(Box(size=size), T), Servo(MODEL, collision, LIMITS, 0.01, q)
        linear = random.standard_normal(3)
        turn = 0.5 * random.standard_normal(3) * random.integers(2)
        target = Twist(linear=0.12 * linear / np.linalg.norm(linear), angular=turn)
        for _ in range(100):
            servo.step(target)
        before, after = (np.minimum(closed.distances(each), 0.0) for each in (q, servo.q))
        deeper.append(1e3 * float((before - after).max()))
        moved += bool(np.abs(servo.q - q).max() > 1e-3)
        kinds[form[0]] = kinds.get(form[0], 0) + 1
    return {
        "what": "jogs in contact with a block that is partly known",
        **kinds,
        "moved": moved,
        "deeper by more than 1 mm": int((np.array(deeper) > 1.0).sum()),
        "deeper, worst [mm]": max(deeper),
    }


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--placements", type=int, default=1000)
    parser.add_argument("--jogs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    random = np.random.default_rng(asked.seed)
    _common.write("bench_solids", [placements(asked.placements, random), jogs(asked.jogs, random)])


if __name__ == "__main__":
    main()
