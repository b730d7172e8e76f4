"""Moving the tool and the jaw in small steps, one a key, as an operation."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from so101_motion.common.errors import So101Error
from so101_motion.common.modes import HELD
from so101_motion.common.operation import LocalOperation, Offer, Row, View
from so101_motion.common.units import to_m, to_mm

if TYPE_CHECKING:
    from so101_motion.common.geometry import Array
    from so101_motion.rig.rig import Rig

STEPS_MM = (10.0, 50.0, 1.0)
_AXES = {"x": ("s", "back", "w", "ahead"), "y": ("d", "right", "a", "left"),
         "z": ("f", "down", "r", "up")}  # fmt: skip


class JogOperation(LocalOperation):
    """Moves the tool of ``rig``, guarded as each jog is; ``close`` brings it to rest."""

    def __init__(self, rig: Rig) -> None:
        super().__init__()
        self._rig, self._jog, self._step = rig, rig.arm.jog(), 0
        self._was_lost = False  # whether its connection was, since the arm was held last
        self._p: Array | None = None  # where the tool was sent; None where it is
        self.commands = {
            "step": self._next_step, "go": self._go, "jaw": self._jaw, "stop": self._stop,
            "hold": self._hold,
        }  # fmt: skip

    @property
    def view(self) -> View:
        rig, size, state = self._rig, STEPS_MM[self._step], self._rig.arm.state
        place = zip(_AXES, to_mm(rig.arm.T_base_tool.p), strict=True)
        rows = (
            *(Row(label=axis, cells=(f"{at:7.1f} mm",)) for axis, at in place),
            Row(label="jaw", cells=(f"{rig.gripper.aperture:7.0%} open",)),
        )
        if state.mode not in HELD:
            hold = Offer(command="hold", title="hold the arm where it stands", key="h")
            is_up = rig.connection.is_up
            self._was_lost |= not is_up
            is_back = self._was_lost and is_up
            text = f"the arm is {'back' if is_back else 'not held'}; let it hold to go on"
            if not is_up:
                text = "the arm is lost; servos that have power hold where they are"
            return View(
                state="loose",
                text=text,
                rows=rows,
                trouble="" if is_back else state.fault or "",
                offers=(hold,),
            )
        self._was_lost = False
        trouble = next((f"{name}: {why}" for name, why in state.reading.alarms.items()), "")
        fix = ""
        if self._jog.held_by and not trouble:
            trouble = f"held back by {', '.join(self._jog.held_by)}"
            fix = "try another way; if none is free, q, then so101 home unfolds the arm"
        return View(
            state="jogging",
            text=f"each key moves the tool by {size:g} mm",
            rows=rows,
            trouble=trouble,
            fix=fix,
            offers=(
                Offer(command="step", title=f"steps of {STEPS_MM[self._next]:g} mm"),
                *(
                    Offer(command="go", title=word, arguments={axis: sign * size}, key=key)
                    for axis, (less, down, more, up) in _AXES.items()
                    for key, word, sign in ((more, up, 1.0), (less, down, -1.0))
                ),
                Offer(command="jaw", title="open the jaw", arguments={"opens": True}, key="o"),
                Offer(command="jaw", title="close it", arguments={"opens": False}, key="c"),
                Offer(command="stop", title="stop the motion", key="x"),
            ),
        )

    def close(self) -> None:
        with suppress(So101Error):  # it ended before, and the view has said why
            self._jog.close().result()

    def _next_step(self) -> None:
        self._step = self._next

    @property
    def _next(self) -> int:
        return (self._step + 1) % len(STEPS_MM)

    def _go(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Mapping[str, Any]:
        """Move the tool by so much [mm] in the base frame; from where it is held, if it is."""
        if self._jog.future.done():  # a fault or a stall ended it
            self._begin()
        at = self._rig.arm.T_base_tool.p if self._p is None or self._jog.held_by else self._p
        wanted = at + to_m(np.array([x, y, z]))
        self._jog.to_point(wanted)
        self._p = wanted
        return {"tool_mm": to_mm(wanted).tolist()}

    def _stop(self) -> None:
        self._rig.arm.stop()  # brakes harder than a jog that is let go
        self._rig.gripper.stop()
        self._begin()

    def _hold(self) -> None:
        self._rig.arm.set_torque(True)
        self._begin()

    def _begin(self) -> None:
        self._jog, self._p = self._rig.arm.jog(), None

    def _jaw(self, opens: bool) -> None:
        (self._rig.gripper.open if opens else self._rig.gripper.close)(wait=False)
