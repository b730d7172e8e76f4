"""The workflow's table: which steps are possible when, and that its picture is current."""

import importlib.util
from pathlib import Path

import pytest

from so101_motion.calib.procedure.steps import INSTRUCTIONS, OFFERED, TABLE, Command, State, step

DOCS = Path(__file__).resolve().parents[4] / "docs"

REQUIRED = {
    Command.START: {State.IDLE, State.COMPLETED, State.ERROR},
    Command.SET_HOMING: {State.STARTED},
    Command.START_RECORDING: {State.HOMED},
    Command.STOP_RECORDING: {State.RECORDING},
    Command.SAVE: {State.COMPLETED},
    Command.ABORT: set(State),
    Command.RESET: set(State),
}
"""As the published module documents it; its ``reset`` works in every state as well."""


def test_the_states_are_the_published_ones():
    assert [state.value for state in State] == [
        "idle", "started", "homing_position", "range_recording", "completed", "error",
    ]  # fmt: skip


@pytest.mark.parametrize("command", Command)
def test_a_command_is_possible_in_its_states_and_in_no_other(command):
    assert {state for state in State if (state, command) in TABLE} == REQUIRED[command]


@pytest.mark.parametrize("state", State)
def test_every_state_is_left_by_what_it_offers(state):
    assert OFFERED[state]
    assert all(step(state, command).then is not state for command in OFFERED[state])
    assert INSTRUCTIONS[state].endswith(".")
    # A failure leads back, or to where the servos are put back.
    for command in Command:
        if (state, command) in TABLE:
            assert step(state, command).otherwise in (state, State.ERROR)


def test_the_page_in_the_documentation_is_current():
    spec = importlib.util.spec_from_file_location("pages", DOCS / "make_calibration_states.py")
    pages = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(pages)
    assert pages.PAGE.read_text(encoding="utf-8") == pages.page(), (
        "run docs/make_calibration_states.py"
    )
