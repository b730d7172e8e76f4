"""The arm of a running machine; sets the machine's caps as well."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from so101_motion.arm.arm import Arm
from so101_motion.arm.joint_caps import JointCaps
from so101_motion.common.errors import So101Error
from so101_motion.viam.requests.commands import in_deg


class MachineArm(Arm):
    """The arm of a machine. ``set_speed`` and ``set_acceleration`` set the machine's as well."""

    tell: Callable[[Mapping[str, Any]], object] | None = None
    """Sends a request to the machine's arm; None if that arm has no such caps."""

    def set_speed(self, speed: float) -> None:
        """See ``Arm.set_speed``; if the machine refuses, nothing changes."""
        before = self._caps
        super().set_speed(speed)
        self._pass_on({"set_speed": in_deg(speed)}, before)

    def set_acceleration(self, acceleration: float) -> None:
        """See ``Arm.set_acceleration``; if the machine refuses, nothing changes."""
        before = self._caps
        super().set_acceleration(acceleration)
        self._pass_on({"set_acceleration": in_deg(acceleration)}, before)

    def _pass_on(self, request: Mapping[str, Any], before: JointCaps) -> None:
        if self.tell is not None:
            try:
                self.tell(request)
            except So101Error:
                self._caps = before
                raise
