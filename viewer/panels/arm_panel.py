"""The panel on the left: the arm's state, its joints, and Stop.

Stop is the only thing to press in its panel. viser sends at most one message per panel every 50 ms
and the last one wins, so beside another button a click on Stop could be lost.
"""

from __future__ import annotations

from collections.abc import Callable

import viser

from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, JointState
from so101_motion.common.units import to_deg

from ..page import markup, texts
from ..page.markup import Bar
from ..page.stop_button import add_stop

_WIDTH = 290
_KEYS = "Space or Esc stops, P plans; no key moves the arm."


class ArmPanel:
    """State, joint angles and Stop.

    Args:
        stops: What Stop calls, each in a thread of its own because they wait for rest.

    Attributes:
        panel: The panel.
        stop_widgets: The button and the keys.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        *,
        title: str,
        stops: tuple[Callable[[], None], ...],
    ) -> None:
        self._title = title
        panel = gui.add_panel()
        with panel.add_tab("Arm", viser.Icon.ROBOT):
            self._state = gui.add_html("")
            self.stop_widgets = add_stop(gui, *stops)
            self._joints = gui.add_html("")
            gui.add_html(markup.small(_KEYS))
        panel.dock_left()
        panel.set_width(_WIDTH)
        self._on_phones = gui.add_html("", order=-20.0)
        self.panel = panel

    def show(self, state: JointState, bounds: tuple[Array, Array], *, lost: bool = False) -> None:
        """Show the state and the joints between their limits.

        Args:
            state: The arm now, or its last known state.
            bounds: Smallest and largest angles, shapes (5,), [rad].
            lost: Whether the arm is disconnected.
        """
        mode = texts.mode(state, lost=lost)
        self._state.content = markup.headline(mode, self._title)
        self._on_phones.content = markup.on_phones(mode, self._title)
        self._joints.content = markup.bars(_bars(state, bounds))


def _bars(state: JointState, bounds: tuple[Array, Array]) -> list[Bar]:
    bars = [
        Bar(name=joint, value=float(value), lower=float(lower), upper=float(upper), unit="°")
        for joint, value, lower, upper in zip(
            ARM_JOINTS, to_deg(state.q), *(to_deg(end) for end in bounds), strict=True
        )
    ]
    opened = 100.0 * (state.q_jaw - JAW_CLOSED) / (JAW_OPEN - JAW_CLOSED)
    jaw = Bar(name="gripper", value=opened, lower=0.0, upper=100.0, unit="%", warns=False)
    return [*bars, jaw]
