import coal
import numpy as np
import pytest
import so101_description

from so101_motion.planning.collision import CollisionModel
from so101_motion.planning.model import RobotModel

# pan, lift, elbow, wrist flex, wrist roll, jaw [deg]; all of them seen to be free on the CAD.
FREE_POSES = {
    "zero": (0, 0, 0, 0, 0, 0),
    "straight_up": (0, -13.97, -73.82, -2.21, 0, 0),
    "extended_forward": (0, 76.03, -73.82, -2.21, 0, 0),
    "ready": (0, -45, 45, 60, 0, 0),
    "ready_topdown": (0, -20, 20, 90, 0, 20),
    "carry": (0, -80, 60, 30, 0, 0),
    "rest_folded_loose": (0, -92, 78, 60, 0, 0),
    "rest_folded": (0, -95, 80, 65, 0, 0),
}


def posture(*angles_deg):
    return np.radians(angles_deg[:5])


BELOW = posture(0, 60, 20, 40, 0)  # the hand reaches 13 cm below the table


@pytest.fixture(scope="module")
def model():
    return RobotModel.load()


@pytest.fixture(scope="module")
def collision(model):
    return CollisionModel(model)


def random_postures(model, count, seed=0):
    return np.random.default_rng(seed).uniform(model.lower, model.upper, (count, 5))


@pytest.mark.parametrize("name", FREE_POSES)
def test_the_named_poses_are_free(collision, name):
    angles = FREE_POSES[name]
    q, q_jaw = posture(*angles), float(np.radians(angles[5]))
    assert collision.is_free(q, q_jaw)
    assert collision.first_contact(q, q_jaw) is None


def test_an_arm_folded_too_far_touches_itself(collision):
    first, second = collision.first_contact(posture(0, -100, 90, 90, 0))
    assert {first, second} <= {
        "base",
        "shoulder",
        "upper arm",
        "lower arm",
        "wrist",
        "gripper",
        "jaw",
    }


def test_a_jaw_below_the_table_touches_the_floor(collision):
    first, second = collision.first_contact(BELOW)
    assert (first, second) == ("jaw", "floor")
    assert collision.clearance(BELOW).distance < -0.02


def test_without_a_floor_the_same_posture_is_free(model):
    nowhere = CollisionModel(model, floor_z=None)
    assert nowhere.is_free(BELOW)
    assert not any("floor" in pair for pair in nowhere.pairs)


def test_the_base_may_stand_on_the_floor(model):
    above = CollisionModel(model, floor_z=0.05)
    assert above.is_free(np.zeros(5))


def test_an_open_gripper_is_wider_than_a_closed_one(model, collision):
    only_closed = [
        q
        for q in random_postures(model, 2000)
        if collision.is_free(q, 0.0) and not collision.is_free(q, 1.7)
    ]
    assert only_closed
    assert any("jaw" in collision.first_contact(q, 1.7) for q in only_closed)


def test_free_means_that_the_closest_pair_keeps_the_margin(model):
    for margin in (0.001, 0.01):
        collision = CollisionModel(model, margin=margin)
        for q in random_postures(model, 300):
            distance = collision.clearance(q).distance
            if abs(distance - margin) > 1e-5:
                assert collision.is_free(q) == (distance > margin)


@pytest.mark.parametrize("margin", [0.0, -0.001, float("nan"), float("inf")])
def test_a_margin_that_is_none_is_refused(model, margin):
    with pytest.raises(ValueError, match="margin"):
        CollisionModel(model, margin=margin)


def test_clearance_is_told_in_words(collision):
    into = collision.clearance(BELOW).told()
    assert into.startswith("the jaw would be ")
    assert into.endswith(" mm into the floor")
    assert " mm from the " in collision.clearance(np.zeros(5)).told("is")


def test_a_motion_of_one_posture_is_that_posture(collision):
    assert collision.blocked_posture(np.zeros((1, 5))) is None
    assert collision.blocked_posture(np.zeros((3, 5))) is None
    low = BELOW
    assert np.array_equal(collision.blocked_posture(low[None]), low)


def test_contact_between_free_postures_is_found(collision):
    # On the way the hand dips into the table.
    begin, end = posture(-90, -10, 60, -20, -40), posture(10, -10, 40, 50, 10)
    assert collision.is_free(begin)
    assert collision.is_free(end)
    blocked = collision.blocked_posture(np.array([begin, end]))
    assert blocked is not None
    assert not collision.is_free(blocked)


def test_no_contact_hides_between_the_postures_looked_at(model, collision):
    found = 0
    postures = [q for q in random_postures(model, 150, seed=1) if collision.is_free(q)]
    for begin, end in zip(postures[::2], postures[1::2], strict=False):
        points = np.linspace(begin, end, 5)
        if collision.blocked_posture(points) is None:
            found += 1
            dense = np.linspace(begin, end, 300)
            assert min(collision.clearance(q).distance for q in dense) > 0.0
    assert found > 20


def test_no_vertex_moves_further_than_the_bound_on_travel(model, collision):
    rng = np.random.default_rng(2)
    vertices = {
        link: so101_description.load_hull(part).vertices
        for link, part in so101_description.PARTS.items()
    }
    for _ in range(200):
        begin = rng.uniform(model.lower, model.upper)
        end = np.clip(begin + rng.normal(0.0, 0.2, 5), model.lower, model.upper)
        q_jaw = float(rng.uniform(-0.17, 1.74))
        before, after = (model.link_placements(q, q_jaw) for q in (begin, end))
        moved = max(
            float(np.linalg.norm(after[link] @ points - before[link] @ points, axis=1).max())
            for link, points in vertices.items()
        )
        assert moved <= collision.travel(np.array([begin, end]))[-1] + 1e-12


def triangles(part):
    """What is drawn of a link, for coal."""
    shape = coal.BVHModelOBBRSS()
    meshes = [surface.mesh for surface in so101_description.load_visual(part)]
    shape.beginModel(sum(len(m.faces) for m in meshes), sum(len(m.vertices) for m in meshes))
    for mesh in meshes:
        corners = mesh.vertices[mesh.faces]
        for a, b, c in corners:
            shape.addTriangle(a, b, c)
    shape.endModel()
    return shape


def test_whatever_touches_as_drawn_is_found(model, collision):
    links = so101_description.PARTS
    shapes = {part.replace("_", " "): triangles(part) for part in links.values()}
    request = coal.CollisionRequest()
    touching = 0
    for q in random_postures(model, 250, seed=3):
        placed = {
            links[link].replace("_", " "): coal.Transform3s(T.R, T.p)
            for link, T in model.link_placements(q, 0.3).items()
        }
        for first, second in collision.pairs:
            if second == "floor":
                continue
            result = coal.CollisionResult()
            coal.collide(
                shapes[first], placed[first], shapes[second], placed[second], request, result
            )
            if result.isCollision():
                touching += 1
                assert not collision.is_free(q, 0.3), (first, second, q)
    assert touching > 20


def test_the_floor_pairs_leave_out_what_cannot_move_towards_it(collision):
    over_floor = {first for first, second in collision.pairs if second == "floor"}
    assert over_floor == {"upper arm", "lower arm", "wrist", "gripper", "jaw"}


def test_the_distance_to_the_floor_is_that_of_the_lowest_vertex(model, collision):
    q = posture(20, -30, 40, 50, 60)
    placed = model.link_placements(q, 0.0)
    lowest = min(
        float((placed[link] @ so101_description.load_hull(part).vertices)[:, 2].min())
        for link, part in so101_description.PARTS.items()
        if part not in ("base", "shoulder")
    )
    floor = [k for k, pair in enumerate(collision.pairs) if "floor" in pair]
    assert collision.distances(q)[floor].min() == pytest.approx(lowest + 0.0024, abs=1e-6)
