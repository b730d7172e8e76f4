from __future__ import annotations

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from so101_viewer.server.control import PATIENCE, Role, WindowControl, WindowStatus


class Room:
    """Window control with a clock and a note of what it told."""

    def __init__(self) -> None:
        self.now = 100.0
        self.told: list[str] = []
        self.control = WindowControl(lambda: self.now, self.told.append)

    def role(self, window: int) -> Role:
        return self.control.status(window).role


def room(*windows: int) -> Room:
    made = Room()
    for window in windows:
        made.control.join(window)
    return made


def test_the_first_window_has_control_and_the_others_watch() -> None:
    here = room(1, 2, 3)
    assert here.control.may_act(1)
    assert not here.control.may_act(2)
    assert here.role(1) is Role.IN_CONTROL
    assert here.control.status(3) == WindowStatus(role=Role.WATCHING, other=1)


def test_a_window_alone_gets_no_message() -> None:
    assert room(1).told == []


def test_control_goes_over_when_it_is_allowed() -> None:
    here = room(1, 2)
    here.control.ask(2)
    assert here.control.status(1).other == 2
    assert here.role(1) is Role.ASKED
    assert here.role(2) is Role.ASKING
    assert here.control.may_act(1), "whoever is asked still has control"
    here.control.answer(1, allow=True)
    assert (here.role(1), here.role(2)) == (Role.WATCHING, Role.IN_CONTROL)
    assert here.told == ["Window 2 asked for control", "Window 2 has control"]


def test_control_stays_when_it_is_denied_and_can_be_asked_for_again() -> None:
    here = room(1, 2)
    here.control.ask(2)
    here.control.answer(1, allow=False)
    assert (here.role(1), here.role(2)) == (Role.IN_CONTROL, Role.WATCHING)
    here.control.ask(2)
    assert here.role(2) is Role.ASKING


def test_no_answer_is_consent_but_not_before_its_time() -> None:
    here = room(1, 2)
    here.control.ask(2)
    here.now += PATIENCE - 0.1
    here.control.tick()
    assert here.role(2) is Role.ASKING
    assert here.control.status(2).seconds == 1
    here.now += 0.1
    here.control.tick()
    assert here.role(2) is Role.IN_CONTROL


def test_only_the_window_in_control_can_answer() -> None:
    here = room(1, 2, 3)
    here.control.ask(2)
    here.control.answer(2, allow=True)
    here.control.answer(3, allow=True)
    assert here.role(1) is Role.ASKED


def test_a_second_asker_waits_for_the_first_to_be_answered() -> None:
    here = room(1, 2, 3)
    here.control.ask(2)
    here.control.ask(3)
    assert here.role(3) is Role.WATCHING
    here.control.answer(1, allow=True)
    assert here.role(2) is Role.IN_CONTROL


def test_control_of_a_closed_window_goes_to_the_next_that_asks() -> None:
    here = room(1, 2)
    here.control.ask(2)
    here.control.leave(1)
    assert here.role(2) is Role.IN_CONTROL


def test_control_of_a_closed_window_is_free_until_somebody_acts() -> None:
    here = room(1, 2, 3)
    here.control.leave(1)
    assert (here.role(2), here.role(3)) == (Role.FREE, Role.FREE)
    assert here.control.may_act(3)
    assert (here.role(2), here.role(3)) == (Role.WATCHING, Role.IN_CONTROL)


def test_a_page_that_is_loaded_again_gets_its_control_back() -> None:
    here = room(1, 2)
    here.control.leave(1)
    here.control.join(1)
    assert here.role(1) is Role.IN_CONTROL


def test_a_window_that_is_not_there_can_do_nothing() -> None:
    here = room()
    assert not here.control.may_act(7)
    here.control.ask(7)
    here.control.join(1)
    assert here.role(1) is Role.IN_CONTROL


class Comings(RuleBasedStateMachine):
    """Whatever windows do, at most one may act, and none loses that without letting go."""

    windows = st.integers(1, 4)

    def __init__(self) -> None:
        super().__init__()
        self.here = Room()

    @rule(window=windows)
    def come(self, window: int) -> None:
        if window not in self.here.control.windows:
            self.here.control.join(window)

    @rule(window=windows)
    def go(self, window: int) -> None:
        self.here.control.leave(window)

    @rule(window=windows)
    def ask(self, window: int) -> None:
        holder = self._holder()
        self.here.control.ask(window)
        if holder is not None:
            assert self._holder() == holder

    @rule(window=windows)
    def act(self, window: int) -> None:
        holder = self._holder()
        allowed = self.here.control.may_act(window)
        assert allowed == (holder == window or (holder is None and self._is_here(window)))

    @precondition(lambda self: self._holder() is not None)
    @rule(allow=st.booleans())
    def answer(self, allow: bool) -> None:
        holder = self._holder()
        assert holder is not None
        self.here.control.answer(holder, allow=allow)
        if not allow:
            assert self._holder() == holder

    @rule(seconds=st.floats(0.0, 2.0 * PATIENCE))
    def wait(self, seconds: float) -> None:
        holder = self._holder()
        asked = holder is not None and self.here.role(holder) is Role.ASKED
        self.here.now += seconds
        self.here.control.tick()
        assert self._holder() == holder or asked

    @invariant()
    def at_most_one_holds(self) -> None:
        roles = [self.here.role(window) for window in self.here.control.windows]
        holding = [role for role in roles if role in (Role.IN_CONTROL, Role.ASKED)]
        assert len(holding) <= 1
        assert holding or all(role is Role.FREE for role in roles)
        assert roles.count(Role.ASKING) == (1 if Role.ASKED in holding else 0)

    def _holder(self) -> int | None:
        held = (Role.IN_CONTROL, Role.ASKED)
        return next((w for w in self.here.control.windows if self.here.role(w) in held), None)

    def _is_here(self, window: int) -> bool:
        return window in self.here.control.windows


TestComings = Comings.TestCase
