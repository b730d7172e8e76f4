"""The panel on the left: the joints between their limits."""

from __future__ import annotations

import viser

from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, JointState
from so101_motion.common.units import to_deg

from ..page import markup
from ..page.markup import Gauge

_WIDTH = 290
_KEYS = "Space or Esc stops, P plans."


def docked_left(gui: viser.GuiApi) -> viser.PanelHandle:
    """The panel on the left, empty."""
    panel = gui.add_panel()
    panel.dock_left()
    panel.set_width(_WIDTH)
    return panel


class ArmPanel:
    """The joint angles of an arm, in a tab that is named after it."""

    def __init__(self, gui: viser.GuiApi, panel: viser.PanelHandle, name: str = "Arm") -> None:
        with panel.add_tab(name, viser.Icon.ROBOT):
            self._joints = gui.add_html("")
            gui.add_html(markup.small(_KEYS))

    def show(self, state: JointState, bounds: tuple[Array, Array]) -> None:
        """Show the joints between their limits.

        Args:
            state: The arm now, or its last known state.
            bounds: Smallest and largest angles, shapes (5,), [rad].
        """
        self._joints.content = markup.gauges(_gauges(state, bounds))


def _gauges(state: JointState, bounds: tuple[Array, Array]) -> list[Gauge]:
    gauges = [
        Gauge(name=joint, value=float(value), lower=float(lower), upper=float(upper), unit="°")
        for joint, value, lower, upper in zip(
            ARM_JOINTS, to_deg(state.q), *(to_deg(end) for end in bounds), strict=True
        )
    ]
    opened = 100.0 * (state.q_jaw - JAW_CLOSED) / (JAW_OPEN - JAW_CLOSED)
    jaw = Gauge(name="gripper", value=opened, lower=0.0, upper=100.0, unit="%", warns=False)
    return [*gauges, jaw]
