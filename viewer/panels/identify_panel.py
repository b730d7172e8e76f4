"""The Servos tab: identify this arm's servos, and weigh what it carries."""

from __future__ import annotations

import viser

from so101_motion.common.modes import Mode
from so101_motion.common.units import to_deg
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.setup.identify_report import IdentifyReport

from ..page import markup, texts
from ..page.identifying import Identifying
from ..page.page_context import ArmContext
from ..page.part import Part
from ..page.screen_state import Sentence, Tone
from ..page.shared_fields import grey

_OFF = Sentence(
    text="Measures how each servo differs from its type. The arm moves, for about three minutes."
)
_PLANNED = Sentence(
    text="Planned; nothing moves yet. Read what will move, then press a button below it.",
    tone=Tone.GOOD,
)
_EMPTY, _CARRYING = "The gripper is empty", "It carries something"


class IdentifyPart(Part):
    """The widgets of the Servos tab.

    Args:
        panel: Where the tab is added.
    """

    def __init__(self, context: ArmContext, rig: HardwareRig, panel: viser.PanelHandle) -> None:
        self._arm, self._identifying = rig.arm, Identifying(rig)
        self._shown: object = None
        gui = context.gui
        with panel.add_tab("Servos", viser.Icon.RULER_MEASURE):
            self._sentence = gui.add_html("")
            self._plan = gui.add_button("Plan the motions", icon=viser.Icon.ROUTE)
            self._note = gui.add_html("", visible=False)
            self._move = gui.add_button_group("Move now", (_EMPTY, _CARRYING), visible=False)
            self._table = gui.add_html("")
        context.on_press(self._plan, self._identifying.plan)
        context.on_choice(
            self._move, lambda name: self._identifying.move(carrying=name == _CARRYING)
        )

    def refresh(self) -> bool:
        """Return whether anything is new."""
        now, before = self._identifying, self._shown
        self._shown = (now.doing, now.outline, now.report, now.trouble, self._arm.state.mode)
        return before != self._shown

    def show(self) -> None:
        """Update the widgets."""
        now = self._identifying
        holds = self._arm.state.mode is Mode.HOLDING
        self._sentence.content = markup.sentence(self._words(), is_whole=True)
        self._plan.disabled = bool(now.doing) or not holds
        asks = now.outline is not None and not now.doing
        self._note.visible = self._move.visible = asks
        grey(self._move, not holds)
        if now.outline is not None:
            left_out = [f"{joint} is left out: {why}" for joint, why in now.outline.obstacles]
            clear = "Move only when nothing is in its way and nobody is near it."
            told = markup.small(" ".join([*left_out, clear]))
            self._note.content = markup.warning(now.outline.sentence) + told
        self._table.content = "" if now.report is None else _table(now.report)

    def close(self) -> None:
        """End what is under way."""
        self._identifying.close()

    def _words(self) -> Sentence:
        now = self._identifying
        if now.doing:
            return Sentence(text=f"{now.doing} … Stop ends it.")
        if now.trouble is not None:
            return texts.ended(now.trouble)
        if now.outline is not None:
            return _PLANNED
        if now.report is not None:
            return Sentence(
                text="Saved beside the calibration and used from now on.", tone=Tone.GOOD
            )
        return texts.blocked(self._arm.state) or _OFF


def _table(report: IdentifyReport) -> str:
    rows = [("", "torque", "friction", "dead time", "play")]
    for joint, each in report.found.servos.items():
        play = "–" if each.play is None else f"{to_deg(each.play):.2f}°"
        shares = (f"{each.torque:.0%}", f"{each.friction:.0%}", f"{each.dead_time:.0%}")
        rows.append((joint, *shares, play))
    return markup.facts(rows) + markup.small(" ".join(map(texts.capital, report.remarks())))
