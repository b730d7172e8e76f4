"""The modes of the arm and the allowed transitions between them, as a table.

The executor asks ``can(mode, event)`` or takes ``after(mode, event)`` and does nothing that the
table does not allow. Two channels move (the arm and the jaw), but torque and faults belong to the
whole bus, so there is one mode.

In two modes a hand can move the arm. In LIMP there is no torque: the arm sinks under its weight. In
GUIDING the arm carries its weight and yields to a hand that pushes it; the jaw holds, and can be
opened and closed. In CALIBRATING the bus is lent, and the borrower may do anything with the servos.
"""

from __future__ import annotations

from enum import Enum


class Mode(Enum):
    """The mode of the arm: what it is doing.

    Attributes:
        LIMP: The torque is off.
        GUIDING: It carries its own weight and yields to a hand.
        HOLDING: It rests, with the torque on.
        MOVING: It moves.
        STOPPING: It comes to rest before its goal.
        CALIBRATING: Its servos are lent to a calibration.
        FAULT: A servo does not answer or reports an alarm; nothing moves.
    """

    LIMP = "limp"
    GUIDING = "guiding"
    HOLDING = "holding"
    MOVING = "moving"
    STOPPING = "stopping"
    CALIBRATING = "calibrating"
    FAULT = "fault"

    @property
    def words(self) -> str:
        """What an arm in this mode is, to be put behind "the arm is"."""
        special = {
            Mode.GUIDING: "guided by hand",
            Mode.CALIBRATING: "being calibrated",
            Mode.FAULT: "in a fault",
        }
        return special.get(self, self.value)


LONGEST_GUIDING = 86400.0  # longest time manual mode can be limited to [s]; chosen, a day

HELD = (Mode.HOLDING, Mode.MOVING, Mode.STOPPING)  # the modes in which all joints are held


class Event(Enum):
    """An event that may change the mode."""

    MOVE = "a motion starts"
    STOP = "a stop is asked for"
    REST = "all motion has ended"
    RELEASE = "torque goes off"
    HOLD = "torque comes on where the joints are"
    GUIDE = "the arm yields to a hand"
    CALIBRATE = "a calibration takes the bus"
    DONE = "the calibration gives it back"
    FAIL = "a fault is seen"


TRANSITIONS: dict[tuple[Mode, Event], Mode] = {
    (Mode.LIMP, Event.HOLD): Mode.HOLDING,
    (Mode.LIMP, Event.GUIDE): Mode.GUIDING,
    (Mode.LIMP, Event.RELEASE): Mode.LIMP,
    (Mode.LIMP, Event.STOP): Mode.LIMP,
    (Mode.LIMP, Event.CALIBRATE): Mode.CALIBRATING,
    (Mode.LIMP, Event.FAIL): Mode.FAULT,
    (Mode.GUIDING, Event.MOVE): Mode.GUIDING,  # of the jaw
    (Mode.GUIDING, Event.GUIDE): Mode.GUIDING,
    (Mode.GUIDING, Event.STOP): Mode.HOLDING,
    (Mode.GUIDING, Event.HOLD): Mode.HOLDING,
    (Mode.GUIDING, Event.RELEASE): Mode.LIMP,
    (Mode.GUIDING, Event.FAIL): Mode.FAULT,
    (Mode.HOLDING, Event.MOVE): Mode.MOVING,
    (Mode.HOLDING, Event.HOLD): Mode.HOLDING,
    (Mode.HOLDING, Event.GUIDE): Mode.GUIDING,
    (Mode.HOLDING, Event.STOP): Mode.HOLDING,
    (Mode.HOLDING, Event.REST): Mode.HOLDING,
    (Mode.HOLDING, Event.RELEASE): Mode.LIMP,
    (Mode.HOLDING, Event.CALIBRATE): Mode.CALIBRATING,
    (Mode.HOLDING, Event.FAIL): Mode.FAULT,
    (Mode.MOVING, Event.MOVE): Mode.MOVING,
    (Mode.MOVING, Event.STOP): Mode.STOPPING,
    (Mode.MOVING, Event.REST): Mode.HOLDING,
    (Mode.MOVING, Event.FAIL): Mode.FAULT,
    (Mode.STOPPING, Event.MOVE): Mode.MOVING,  # the other channel starts a motion meanwhile
    (Mode.STOPPING, Event.STOP): Mode.STOPPING,
    (Mode.STOPPING, Event.REST): Mode.HOLDING,
    (Mode.STOPPING, Event.FAIL): Mode.FAULT,
    (Mode.CALIBRATING, Event.STOP): Mode.CALIBRATING,  # no motion of ours to stop
    (Mode.CALIBRATING, Event.DONE): Mode.LIMP,
    (Mode.FAULT, Event.STOP): Mode.FAULT,
    (Mode.FAULT, Event.CALIBRATE): Mode.CALIBRATING,
    (Mode.FAULT, Event.RELEASE): Mode.LIMP,
    (Mode.FAULT, Event.HOLD): Mode.HOLDING,
}
"""Every legal step; what is not here is refused."""


def can(mode: Mode, event: Event) -> bool:
    return (mode, event) in TRANSITIONS


_REFUSALS = {
    Event.MOVE: "the arm cannot move",
    Event.RELEASE: "torque cannot go off",
    Event.HOLD: "the arm cannot be told to hold",
    Event.GUIDE: "the arm cannot be guided by hand",
    Event.CALIBRATE: "a calibration cannot start",
}


def refusal(mode: Mode, event: Event) -> str:
    first = "leave manual mode first" if mode is Mode.GUIDING else "stop it or wait until it rests"
    return f"{_REFUSALS[event]} while the arm is {mode.words}; {first}"


def after(mode: Mode, event: Event) -> Mode:
    """The mode that follows ``event`` in ``mode``; ``ValueError`` if the step is not legal."""
    try:
        return TRANSITIONS[mode, event]
    except KeyError:
        raise ValueError(f"{event.value} is not possible while {mode.value}") from None
