"""The calibration workflow as a state machine: a table of states, commands and transitions.

A command that the table does not list for the state is refused and changes nothing. A listed one is
carried out by ``session.py``, and leads to ``then`` or, if it fails, to ``otherwise``. One whose
failure changes nothing stays in its state, so it can be given again; a calibration that failed
half-way is in ``error``, where the servos may have to be put back: ``reset`` and ``start`` do that.
States and commands have the published module's names.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from so101_motion.common.errors import CalibrationError


class State(Enum):
    """The state of a calibration."""

    IDLE = "idle"
    STARTED = "started"
    HOMED = "homing_position"
    RECORDING = "range_recording"
    COMPLETED = "completed"
    ERROR = "error"


class Command(Enum):
    """A command to a calibration."""

    START = "start"
    SET_HOMING = "set_homing"
    START_RECORDING = "start_range_recording"
    STOP_RECORDING = "stop_range_recording"
    SAVE = "save_calibration"
    ABORT = "abort"
    RESET = "reset"


@dataclass(frozen=True, slots=True)
class Transition:
    """The states that a command leads to, if it succeeds and if it fails."""

    then: State
    otherwise: State


TABLE: dict[tuple[State, Command], Transition] = {
    (State.IDLE, Command.START): Transition(State.STARTED, State.ERROR),
    (State.COMPLETED, Command.START): Transition(State.STARTED, State.ERROR),
    (State.ERROR, Command.START): Transition(State.STARTED, State.ERROR),
    (State.STARTED, Command.SET_HOMING): Transition(State.HOMED, State.ERROR),
    (State.HOMED, Command.START_RECORDING): Transition(State.RECORDING, State.HOMED),
    (State.RECORDING, Command.STOP_RECORDING): Transition(State.COMPLETED, State.RECORDING),
    (State.COMPLETED, Command.SAVE): Transition(State.IDLE, State.COMPLETED),
    **{(state, Command.ABORT): Transition(State.IDLE, State.ERROR) for state in State},
    **{(state, Command.RESET): Transition(State.IDLE, State.ERROR) for state in State},
}
"""Every possible step; all others are refused."""

OFFERED: dict[State, tuple[Command, ...]] = {
    State.IDLE: (Command.START,),
    State.STARTED: (Command.SET_HOMING, Command.ABORT),
    State.HOMED: (Command.START_RECORDING, Command.ABORT),
    State.RECORDING: (Command.STOP_RECORDING, Command.ABORT),
    State.COMPLETED: (Command.SAVE, Command.START, Command.ABORT),
    State.ERROR: (Command.RESET, Command.START),
}
"""Commands to offer next, the usual one first; ``abort`` and ``reset`` are always possible."""

INSTRUCTIONS: dict[State, str] = {
    State.IDLE: "Ready. Support the arm with one hand before you start: its joints go limp.",
    State.STARTED: (
        "The joints are limp. Hold each about in the middle of its travel: upper arm upright,"
        " forearm and gripper level and straight ahead, and the gripper turned so that it opens"
        " straight upwards: wrist_roll has no stops, so its zero is taken from this. Then set the"
        " homing position."
    ),
    State.HOMED: "Homing is set. Start the recording, then move every joint from stop to stop.",
    State.RECORDING: "Recording. Move every joint slowly through its whole travel, to both stops.",
    State.COMPLETED: "Everything is recorded. Save the calibration, or start again.",
    State.ERROR: "Something went wrong. Reset to put the servos back as they were, or start again.",
}
"""What a person should do in each state."""


def step(state: State, command: Command) -> Transition:
    found = TABLE.get((state, command))
    if found is None:
        names = " or ".join(f'"{offered.value}"' for offered in OFFERED[state])
        reason = f'"{command.value}" is not possible in the state "{state.value}"'
        raise CalibrationError(None, reason, f"now possible: {names}")
    return found
