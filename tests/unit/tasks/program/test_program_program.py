from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.common.errors import ConfigError
from so101_motion.tasks.program.program import MOST, Program, Waypoint


def waypoint(name: str) -> Waypoint:
    return Waypoint(name=name, q=np.zeros(5))


def program(names: str) -> Program:
    return Program(waypoints=tuple(waypoint(name) for name in names))


def names(made: Program) -> str:
    return "".join(each.name for each in made.waypoints)


def test_waypoints_are_added_changed_and_removed() -> None:
    made = program("abc")
    assert names(made.with_waypoint(waypoint("d"))) == "abcd"
    assert names(made.without(1)) == "ac"
    assert names(made.with_changed(0, waypoint("z"))) == "zbc"
    assert names(made) == "abc"
    assert made.called(1) == "waypoint 2 (b)"


@given(st.data())
def test_moving_a_waypoint_keeps_the_order_of_the_others_and_can_be_undone(
    data: st.DataObject,
) -> None:
    made = program("abcdefgh"[: data.draw(st.integers(1, 8))])
    place = st.integers(0, len(made) - 1)
    index, to = data.draw(place), data.draw(place)
    moved = made.moved(index, to)
    assert moved.waypoints[to] is made.waypoints[index]
    taken = made.waypoints[index].name
    assert names(moved).replace(taken, "") == names(made).replace(taken, "")
    assert names(moved.moved(to, index)) == names(made)


@given(st.lists(st.booleans(), min_size=1, max_size=12))
def test_every_waypoint_is_in_one_stretch_and_a_stretch_ends_where_the_arm_stops(
    passes: list[bool],
) -> None:
    made = Program(
        waypoints=tuple(Waypoint(name="a", q=np.zeros(5), passes=each) for each in passes)
    )
    stretches = [*made.stretches()]
    assert [index for each in stretches for index in each] == [*range(len(passes))]
    for each in stretches:
        assert [made.stops_at(index) for index in each] == [False] * (len(each) - 1) + [True]


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: waypoint(""), "type a name first"),
        (lambda: Waypoint(name="a", q=np.zeros(5), pause=-1.0), "pause"),
        (lambda: Waypoint(name="a", q=np.zeros(5), pause=float("nan")), "pause"),
        (lambda: Waypoint(name="a", q=np.zeros(5), aperture=1.1), "aperture"),
        (lambda: Waypoint(name="a", q=np.zeros(5), pause=1.0, passes=True), "a pause"),
        (lambda: Waypoint(name="a", q=np.zeros(5), aperture=0.5, passes=True), "the gripper"),
        (lambda: Program(waypoints=(waypoint("a"),) * (MOST + 1)), "make two programs"),
        (lambda: Program(rounds=0), "rounds"),
        (lambda: program("ab").without(2), "is not one of the program's 2"),
        (lambda: program("ab").moved(0, 2), "is not one of the program's 2"),
    ],
)
def test_what_cannot_be_meant_is_refused(make: object, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        make()  # type: ignore[operator]
