import pytest

from so101_motion.common.modes import TRANSITIONS, Event, Mode, after, can


@pytest.mark.parametrize(
    ("event", "modes"),
    [
        (Event.MOVE, {Mode.HOLDING, Mode.GUIDING, Mode.MOVING, Mode.STOPPING}),
        (Event.STOP, set(Mode)),
        (Event.CALIBRATE, {Mode.LIMP, Mode.HOLDING, Mode.FAULT}),
        (Event.FAIL, set(Mode) - {Mode.FAULT, Mode.CALIBRATING}),
    ],
)
def test_an_event_is_legal_only_in_these_modes(event, modes):
    assert {mode for mode in Mode if can(mode, event)} == modes


def test_while_the_bus_is_lent_nothing_but_giving_it_back_is_legal():
    legal = {event for event in Event if can(Mode.CALIBRATING, event)}
    assert legal == {Event.STOP, Event.DONE}


def test_a_stop_and_the_end_of_a_motion_lead_to_an_arm_that_holds_or_was_not_held():
    assert after(Mode.GUIDING, Event.STOP) is Mode.HOLDING
    for mode in (Mode.LIMP, Mode.HOLDING, Mode.CALIBRATING, Mode.FAULT):
        assert after(mode, Event.STOP) is mode
    for mode in (Mode.MOVING, Mode.STOPPING):
        assert after(mode, Event.REST) is Mode.HOLDING


def test_every_mode_can_be_reached_and_left_and_an_illegal_step_says_what_and_where():
    assert {mode for mode, _ in TRANSITIONS} == set(Mode)
    assert set(TRANSITIONS.values()) == set(Mode)
    with pytest.raises(ValueError, match="a motion starts is not possible while limp"):
        after(Mode.LIMP, Event.MOVE)
