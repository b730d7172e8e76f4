import pytest

from so101_motion.modes import TRANSITIONS, Event, Mode, after, can


def test_the_arm_moves_only_while_it_is_driven_and_healthy():
    driven = {Mode.HOLDING, Mode.MOVING, Mode.STOPPING}
    assert {mode for mode in Mode if can(mode, Event.MOVE)} == driven


def test_stop_is_legal_in_every_mode_but_calibrating():
    assert {mode for mode in Mode if not can(mode, Event.STOP)} == {Mode.CALIBRATING}


def test_a_fault_can_be_seen_in_every_mode_but_a_fault():
    assert {mode for mode in Mode if not can(mode, Event.FAIL)} == {Mode.FAULT}


def test_nothing_but_holding_follows_a_motion():
    assert after(Mode.MOVING, Event.REST) is Mode.HOLDING
    assert after(Mode.STOPPING, Event.REST) is Mode.HOLDING


def test_every_mode_can_be_reached_and_left():
    assert {mode for mode, _ in TRANSITIONS} == set(Mode)
    assert set(TRANSITIONS.values()) == set(Mode)


def test_an_illegal_step_says_what_and_where():
    with pytest.raises(ValueError, match="a motion starts is not possible while limp"):
        after(Mode.LIMP, Event.MOVE)
