import numpy as np
import pytest
import so101_description

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.bodies import bodies_in
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Attached, Box, Scene

STICK = Attached(
    name="stick",
    shape=Box(size=(0.02, 0.3, 0.03)),
    T_tool_object=SE3.from_translation((0.02, 0.05, 0.12)),
)
HULLS = {
    link: so101_description.load_hull(part).vertices
    for link, part in so101_description.PARTS.items()
}
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [
    0.01,
    0.15,
    0.015,
]


def arm_points(model, q, q_jaw, attached):
    """All vertices of all links, and of what is held, in base."""
    placed = model.link_placements(q, q_jaw)
    points = [T @ HULLS[link] for link, T in placed.items()]
    if attached:
        points.append(model.frame(q) @ STICK.T_tool_object @ CORNERS)
    return np.concatenate(points)


@pytest.mark.parametrize("attached", [(), (STICK,)], ids=["empty hand", "stick"])
def test_no_vertex_moves_further_than_the_bound_on_travel(model, attached):
    scene = Scene(attached=attached)
    collision, levers = CollisionModel(model, scene), bodies_in(model.pin_model, scene).levers
    rng = np.random.default_rng(2)
    share = 0.0
    for _ in range(400):
        begin = rng.uniform(model.lower, model.upper)
        step = rng.normal(0.0, 0.2, 5) * (rng.random(5) < 0.5)
        end = np.clip(begin + step, model.lower, model.upper)
        q_jaw = float(rng.uniform(-0.17, 1.74))
        before, after = (arm_points(model, q, q_jaw, attached) for q in (begin, end))
        moved = float(np.linalg.norm(after - before, axis=1).max())
        bound = float(np.abs(end - begin) @ levers.at(q_jaw))
        assert moved <= bound + 1e-12
        assert bound <= collision.travel(np.array([begin, end]))[-1] + 1e-12
        share = max(share, moved / bound if bound else 0.0)
    assert share > 0.6, "the bound is no tighter than it need be"


def test_what_is_held_reaches_further(model):
    empty, full = CollisionModel(model), CollisionModel(model, Scene(attached=(STICK,)))
    assert np.all(full.reach >= empty.reach)
    assert full.reach[4] == pytest.approx(0.2, abs=0.02)


def test_an_open_jaw_reaches_further_around_the_roll(model):
    levers = bodies_in(model.pin_model, Scene()).levers
    assert levers.at(1.7)[4] > 2.0 * levers.at(0.0)[4]
    assert np.all(levers.longest >= levers.at(0.7))
