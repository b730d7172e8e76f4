from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from so101_motion.common.errors import ConfigError
from so101_motion.tasks.program.loops import Loop
from so101_motion.tasks.program.program import ARM, MOST, Program, Waypoint


def step(name):
    return {ARM: waypoint(name)}


def waypoint(name):
    return Waypoint(name=name, q=np.zeros(5))


def program(names):
    return Program.of_waypoints(tuple(waypoint(name) for name in names))


def names(made):
    return "".join(each.name for each in made.waypoints)


def test_waypoints_are_added_changed_and_removed():
    made = program("abc")
    assert names(made.with_step(step("d"))) == "abcd"
    assert names(made.without(1)) == "ac"
    assert names(made.with_changed(0, step("z"))) == "zbc"
    assert names(made) == "abc"
    assert made.called(1) == "waypoint 2 (b)"


def test_a_program_of_one_arm_can_be_given_to_all():
    made = Program.of_waypoints([waypoint("a"), replace(waypoint("b"), passes=True)])
    given_to_all = made.for_all(["anna", "ben"])
    assert given_to_all.arms == ("anna", "ben")
    assert [step["ben"].name for step in given_to_all.steps] == ["a", "b"]
    assert not any(step["anna"].passes for step in given_to_all.steps)


@given(st.data())
def test_moving_a_waypoint_keeps_the_order_of_the_others_and_can_be_undone(data):
    made = program("abcdefgh"[: data.draw(st.integers(1, 8))])
    place = st.integers(0, len(made) - 1)
    index, to = data.draw(place), data.draw(place)
    moved = made.moved(index, to)
    assert moved.waypoints[to] is made.waypoints[index]
    taken = made.waypoints[index].name
    assert names(moved).replace(taken, "") == names(made).replace(taken, "")
    assert names(moved.moved(to, index)) == names(made)


@given(st.lists(st.booleans(), min_size=1, max_size=12))
def test_every_waypoint_is_on_one_leg_and_a_leg_ends_where_the_arm_stops(passes):
    made = Program.of_waypoints(Waypoint(name="a", q=np.zeros(5), passes=each) for each in passes)
    legs = [each.indices for each in made.visits()]
    assert [index for each in legs for index in each] == [*range(len(passes))]
    for each in legs:
        assert [made.stops_at(index) for index in each] == [False] * (len(each) - 1) + [True]


def looped(names, *loops, passed=""):
    """A program of one-letter waypoints; loops say first, last and times."""
    return Program.of_waypoints(
        (replace(waypoint(name), passes=name in passed) for name in names),
        loops=tuple(Loop(first=first, last=last, times=times) for first, last, times in loops),
    )


def test_a_program_is_put_into_another_with_its_loops_and_rounds():
    inner = looped("xy", (1, 1, 2)).with_rounds(3)
    made = looped("abc", (0, 1, 2), (2, 2, 4)).with_program(inner, 2)
    assert names(made) == "abxyc"
    assert {(each.first, each.last, each.times) for each in made.loops} == {
        (0, 1, 2), (2, 3, 3), (3, 3, 2), (4, 4, 4)
    }  # fmt: skip
    with pytest.raises(ConfigError, match="never ends"):
        made.with_program(inner.with_rounds(None), 0)


def order(made, most=None):
    """The waypoints as they are gone through; a comma where the arm stops."""
    legs = (made.waypoints[each.indices.start : each.indices.stop] for each in made.visits(most))
    return ",".join("".join(each.name for each in leg) for leg in legs)


@pytest.mark.parametrize(
    ("made", "goes"),
    [
        (looped("abcd", (1, 2, 3)), "a,b,c,b,c,b,c,d"),
        (looped("ab", (0, 1, 2)), "a,b,a,b"),
        (looped("abc", (1, 1, 3)), "a,b,b,b,c"),
        (looped("abcd", (0, 3, 2), (1, 2, 2)), "a,b,c,b,c,d,a,b,c,b,c,d"),
        (looped("abc", (0, 2, 2), (0, 1, 2)), "a,b,a,b,c,a,b,a,b,c"),  # they begin together
        (looped("abc", (0, 2, 2), (1, 2, 2)), "a,b,c,b,c,a,b,c,b,c"),  # they end together
        (looped("abcd", (0, 1, 2), (2, 3, 2)), "a,b,a,b,c,d,c,d"),
        (looped("abcd", (1, 2, 2), passed="abc"), "abc,bc,d"),  # it turns back, so it stops
    ],
)
def test_loops_run_where_they_stand(made, goes):
    assert order(made) == goes
    again = made.with_rounds(2)
    assert order(again) == f"{goes},{goes}"
    assert order(again.with_rounds(None), most=2) == order(again, most=2)
    laps = [each.laps for each in made.visits()]
    assert len({*laps}) > 1
    assert {len(each) for each in laps} <= {0, 1, 2}


PLACES = st.integers(0, 6)
LOOPS = st.lists(
    st.tuples(PLACES, PLACES, st.integers(2, 4)).map(lambda a: (min(a[:2]), max(a[:2]), a[2])),
    max_size=3,
)


@given(LOOPS, PLACES, PLACES, st.lists(st.sampled_from([None, 0.0, 1.0]), min_size=7, max_size=7))
def test_loops_survive_every_edit_and_two_rounds_show_every_leg_with_every_jaw(
    loops, index, to, apertures
):
    try:
        made = looped("abcdefg", *loops)
    except ConfigError:
        assume(False)
    for edited in (made.without(index), made.moved(index, to), made.part(min(index, to), 7)):
        assert len(edited.loops) <= len(made.loops)
        assert all(loop.last < len(edited) for loop in edited.loops)

    def legs(most):
        found, jaw, origin = set(), 0.5, None
        for visit in made.with_rounds(3).visits(most):
            found.add((origin, visit.indices, jaw))
            origin = visit.indices[-1]
            told = apertures[origin]
            jaw = jaw if told is None else told
        return found

    assert legs(2) == legs(None)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: waypoint(""), "type a name first"),
        (lambda: Waypoint(name="a", q=np.zeros(5), pause=float("nan")), "pause"),
        (lambda: Waypoint(name="a", q=np.zeros(5), aperture=0.5, passes=True), "the gripper"),
        (lambda: Program.of_waypoints((waypoint("a"),) * (MOST + 1)), "make two programs"),
        (lambda: program("ab").without(2), "is not one of the program's 2"),
        (lambda: program("ab").moved(0, 2), "is not one of the program's 2"),
        (lambda: looped("ab", (1, 0, 2)), "not after its end"),
        (lambda: looped("ab", (0, 1, 1)), "times"),
        (lambda: looped("abc", (0, 1, 2), (1, 2, 2)), "overlaps the loop 2 to 3; put one inside"),
        (lambda: looped("abc", (0, 2, 2), (0, 1, 2), (0, 0, 2)), "in more than 2 loops"),
    ],
)
def test_invalid_input_is_refused(make, reason):
    with pytest.raises(ConfigError, match=reason):
        make()
