import pytest

from so101_motion.common.modes import TRANSITIONS, Event, Mode, after, can


def test_the_arm_moves_only_while_it_is_driven_and_healthy():
    driven = {Mode.HOLDING, Mode.GUIDING, Mode.MOVING, Mode.STOPPING}
    assert {mode for mode in Mode if can(mode, Event.MOVE)} == driven


def test_stop_is_legal_in_every_mode():
    assert all(can(mode, Event.STOP) for mode in Mode)


def test_a_stop_ends_with_an_arm_that_holds_or_was_not_held():
    assert after(Mode.GUIDING, Event.STOP) is Mode.HOLDING
    for mode in (Mode.LIMP, Mode.HOLDING, Mode.CALIBRATING, Mode.FAULT):
        assert after(mode, Event.STOP) is mode


def test_while_the_bus_is_lent_nothing_but_giving_it_back_is_legal():
    legal = {event for event in Event if can(Mode.CALIBRATING, event)}
    assert legal == {Event.STOP, Event.DONE}


def test_the_bus_is_lent_only_while_nothing_of_ours_moves_or_yields():
    assert {mode for mode in Mode if can(mode, Event.CALIBRATE)} == {
        Mode.LIMP, Mode.HOLDING, Mode.FAULT,
    }  # fmt: skip


def test_a_fault_can_be_seen_in_every_mode_in_which_servos_are_ours():
    blind = {Mode.FAULT, Mode.CALIBRATING}
    assert {mode for mode in Mode if not can(mode, Event.FAIL)} == blind


def test_nothing_but_holding_follows_a_motion():
    assert after(Mode.MOVING, Event.REST) is Mode.HOLDING
    assert after(Mode.STOPPING, Event.REST) is Mode.HOLDING


def test_every_mode_can_be_reached_and_left():
    assert {mode for mode, _ in TRANSITIONS} == set(Mode)
    assert set(TRANSITIONS.values()) == set(Mode)


def test_an_illegal_step_says_what_and_where():
    with pytest.raises(ValueError, match="a motion starts is not possible while limp"):
        after(Mode.LIMP, Event.MOVE)
