"""Which of the bar's buttons can be pressed during a setup, and why the others cannot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from so101_viewer.page import cards
from so101_viewer.setup.setup_target import SetupTarget
from so101_viewer.setup_app import reasons

from so101_motion.calib.procedure.steps import State
from so101_motion.common.modes import Mode
from so101_motion.common.operation import Row

CAN = None


@dataclass(kw_only=True)
class Arm:
    """An arm that is set up; a calibrated one that is held, unless said otherwise."""

    mode: Mode = Mode.HOLDING
    holds: bool | None = True
    state: State = State.IDLE
    is_calibrated: bool = True
    answers: bool = True
    is_connected: bool = True
    has_rig: bool = True

    def target(self) -> SetupTarget:
        situation = SimpleNamespace(
            is_connected=self.is_connected,
            holds=self.holds,
            view=SimpleNamespace(state=self.state),
            saved=Path("arm.json") if self.is_calibrated else None,
            joints={"elbow_flex": SimpleNamespace(ticks=2048 if self.answers else None)},
        )
        rig = SimpleNamespace(arm=SimpleNamespace(state=SimpleNamespace(mode=self.mode)))
        found = SimpleNamespace(situation=situation, rig=rig if self.has_rig else None)
        return cast(SetupTarget, found)


HELD, LIMP = "The joints are held already", "The joints are limp already"
CALIBRATED = "A calibration is under way"


@pytest.mark.parametrize(
    ("arm", "hold", "guide", "let_go"),
    [
        (Arm(), HELD, CAN, CAN),
        (Arm(mode=Mode.MOVING), HELD, "Something moves: press STOP first", CAN),
        (Arm(mode=Mode.GUIDING), CAN, "Guide by hand is on already", CAN),
        (Arm(mode=Mode.LIMP, holds=False), CAN, "press Hold first", LIMP),
        (Arm(mode=Mode.LIMP, holds=True), CAN, "press Hold first", CAN),  # by another program
        (Arm(mode=Mode.FAULT), CAN, "There is a fault: press Hold first", CAN),
        (Arm(is_calibrated=False), HELD, "Only a calibrated arm", CAN),
        (
            Arm(mode=Mode.LIMP, holds=None, answers=False, is_calibrated=False),
            "Not all six motors answer", "Only a calibrated arm", "No motor answers",
        ),
        (
            Arm(mode=Mode.CALIBRATING, state=State.RECORDING, holds=False),
            CALIBRATED, CALIBRATED, LIMP,
        ),
        (Arm(mode=Mode.CALIBRATING, state=State.ERROR), CALIBRATED, CALIBRATED, CAN),
        (Arm(is_connected=False), *("There is no connection",) * 3),
        (Arm(has_rig=False), *("The machine has no arm yet",) * 3),
    ],
)  # fmt: skip
def test_each_grey_button_says_why(
    arm: Arm, hold: str | None, guide: str | None, let_go: str | None
) -> None:
    for said, wanted in zip(reasons(arm.target(), ""), (hold, guide, let_go), strict=True):
        assert (said is None) is (wanted is None), said
        assert (wanted or "") in (said or "")


def test_without_an_arm_nothing_can_be_pressed() -> None:
    assert reasons(None, "") == ("No arm is connected yet.",) * 3


def test_letting_go_waits_for_nothing() -> None:
    hold, guide, let_go = reasons(Arm().target(), "planning the test")
    assert hold == guide == "Wait for the end of this: planning the test."
    assert let_go is None


def test_markup_escapes_what_comes_from_outside() -> None:
    evil = "<script>alert(1)</script>"
    row = Row(label=evil, cells=(evil,), text=evil, tone="warm", mark=evil, bar=(0.2, 0.4), at=0.3)
    pieces = (cards.rows((evil,), (row,)), cards.instruction(evil, evil), cards.failed(evil))
    assert all("<script>" not in piece for piece in pieces)
