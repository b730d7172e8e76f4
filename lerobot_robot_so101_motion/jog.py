"""Move the tool with keys or a gamepad, as a teleoperator: ``--teleop.type=so101_motion_jog``.

The Cartesian servo turns what is held into joint angles, the actions that the robot follows.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from lerobot.teleoperators import Teleoperator
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_so101_motion.config import SO101MotionJogConfig
from lerobot_robot_so101_motion.held_keys import HELP, Held, open_held
from lerobot_robot_so101_motion.so101_device import SO101Device, open_arms
from lerobot_robot_so101_motion.units import KEYS
from so101_motion.common.errors import So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_m, to_rad
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.differential.targets import STILL, Twist
from so101_motion.planning.timing.limits import MotionLimits

_log = logging.getLogger(__name__)

JAW_RATE = 0.6  # speed of the jaw, as share of its travel [1/s]; chosen
CATCH_UP = 0.1  # most time that an action covers [s]; chosen, more than a period at 15 Hz

AWAY = to_rad(1.0)
"""The servo starts again if the arm rests farther than this from it [rad]; chosen."""

LEFT_BEHIND = to_rad(4.0)
"""The tool stops while the arm is farther than this behind [rad]; chosen, nearer than ``GATE``,
from where an arm that waits follows again."""

CAPS = MotionLimits.uniform(velocity=to_rad(120.0), acceleration=to_rad(300.0), jerk=100.0)
"""Caps of the joints while the tool moves, unless the arm's are lower. Chosen."""

LOG_EVERY = 1.0  # how often the log says what holds the tool back [s]; chosen
_HELD_BELOW = 0.5  # share of the wanted speed; below it the log says what holds the tool back


class SO101MotionJog(Teleoperator):
    """Moves the tool of the one arm of this program."""

    config_class = SO101MotionJogConfig
    name = "so101_motion_jog"

    def __init__(self, config: SO101MotionJogConfig) -> None:
        super().__init__(config)
        self.config = config
        self._device: Held | None = None
        self._lead: _ToolLead | None = None

    @property
    def action_features(self) -> dict[str, Any]:
        return dict.fromkeys(KEYS, float)

    @property
    def feedback_features(self) -> dict[str, Any]:
        return {}

    @property
    def is_connected(self) -> bool:
        return self._device is not None

    @property
    def is_calibrated(self) -> bool:
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Open the keyboard or the gamepad."""
        if self._device is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._device = open_held(self.config.device)
        if self.config.device == "keyboard":
            _log.info(HELP)

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    def get_action(self) -> dict[str, Any]:
        """The next target of the joints."""
        if self._device is None:
            raise DeviceNotConnectedError(f"{self} is not connected. Run `.connect()` first.")
        arm = _only_arm()
        try:
            if self._lead is None or self._lead.arm is not arm:
                self._lead = _ToolLead(arm, self.config)
            return self._lead.next(self._device.read(arm.session.rig.clock.now()))
        except So101Error as error:
            raise ConnectionError(f"{self} cannot move the tool: {error}") from error

    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Do nothing."""

    def disconnect(self) -> None:
        """Close the keyboard or the gamepad."""
        if self._device is None:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        device, self._device = self._device, None
        self._lead = None
        device.close()


class _ToolLead:
    """Turns held keys into joint targets of one arm."""

    def __init__(self, arm: SO101Device, config: SO101MotionJogConfig) -> None:
        self.arm, self._in_tool = arm, config.in_tool
        self._speed = np.repeat(
            (to_m(config.speed_mm_per_sec), to_rad(config.turning_degs_per_sec)), 3
        )
        rig = arm.session.rig
        self._model = rig.arm.model.narrowed(*rig.arm.range)
        self._collision = CollisionModel(self._model, rig.arm.scene)
        self._limits = rig.arm.effective_limits(CAPS)
        self._aperture = rig.gripper.aperture
        self._t = self._logged_at = rig.clock.now()
        self._left = 0.0  # time that is no whole step yet [s]
        self._was_held = False
        self._servo = self._begin()

    def next(self, held: Array) -> dict[str, float]:
        """The next action for the held keys, shape (7,), -1 to 1."""
        rig = self.arm.session.rig
        now, dt = rig.clock.now(), rig.executor.dt
        elapsed, self._t = min(now - self._t, CATCH_UP), now
        is_held = bool(held[:6].any())
        if is_held and not self._was_held and self._is_elsewhere():
            self._servo = self._begin()
        self._was_held, is_jogged = is_held, is_held and self._off() <= LEFT_BEHIND
        steps, self._left = divmod(self._left + elapsed, dt)
        speeds = self._speed * held[:6]
        twist = Twist(linear=speeds[:3], angular=speeds[3:], in_tool=self._in_tool)
        for _ in range(int(steps)):
            step = self._servo.step(twist if is_jogged else STILL, rig.gripper.q_jaw)
            if is_jogged and step.share < _HELD_BELOW:
                self._log_holder(now)
        self._aperture = min(max(self._aperture + JAW_RATE * elapsed * held[6], 0.0), 1.0)
        return self.arm.session.units.to_lerobot(self._servo.q, self._aperture)

    def _begin(self) -> Servo:
        rig = self.arm.session.rig
        q, dt = self.arm.session.state.q_ref, rig.executor.dt
        return Servo(self._model, self._collision, self._limits, dt, q)

    def _off(self) -> float:
        """Largest joint distance between the arm and the servo [rad]."""
        return float(np.max(np.abs(self.arm.session.state.q_ref - self._servo.q)))

    def _is_elsewhere(self) -> bool:
        """Whether arm and servo are at rest in different positions."""
        is_at_rest = not self._servo.qd.any() and not self.arm.session.state.qd_ref.any()
        return is_at_rest and self._off() > AWAY

    def _log_holder(self, now: float) -> None:
        held_by = self._servo.held_by()
        if held_by and now - self._logged_at >= LOG_EVERY:
            self._logged_at = now
            _log.info("the tool is held back by %s", " and ".join(held_by))


def _only_arm() -> SO101Device:
    arms = open_arms()
    if len(arms) != 1:
        found = f"{len(arms)} are" if arms else "none is"
        raise DeviceNotConnectedError(
            f"keys and gamepads move one arm of this program, but {found} connected; use"
            " --robot.type=so101_motion"
        )
    return arms[0]
