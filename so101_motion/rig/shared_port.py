"""Share the servos and the rig of one serial port between several components.

``servos.settings`` has the combined settings of the components, ``servos.in_force`` those of the
last setup. A caller that can wait applies new settings at once (``connect``, ``rebuild``). For an
event loop, which cannot wait, the port's own thread does it (``set_up_soon``), and goes on trying
while servos stay silent, exactly as after a cable was pulled.

When a component leaves, nothing is set up: the servos stay as they are until a component joins, the
calibration is loaded again or the bus comes back from a loan. So the servos of an arm that is being
replaced are driven until the new one is there.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace

import numpy as np

from so101_motion.common.clock import Clock, MonotonicClock
from so101_motion.common.errors import ConfigError, MotionError, NoReply, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.realtime import use_realtime_priority
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_rad
from so101_motion.control.executor import Executor, Tolerances
from so101_motion.control.joint_controller import JointController
from so101_motion.drivers.bus.bus import reply_timeout_in
from so101_motion.drivers.feetech.arm_weight import ArmWeight
from so101_motion.drivers.feetech.gravity_compensation import (
    LEFT_ALONE,
    SETTLE_POSITION,
    SETTLE_TIMEOUT,
    SETTLE_VELOCITY,
)
from so101_motion.drivers.port.serial_port import PortOpener
from so101_motion.files.failure_record import FailureRecorder
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import place_in_hand
from so101_motion.rig.port_settings import ServoSettings, about_unused_file, combined
from so101_motion.rig.rig import HARD_STOP, TICK, Rig
from so101_motion.rig.servo_driver import ServoDriver
from so101_motion.rig.session_end import leave

_log = logging.getLogger(__name__)

HARDWARE_TOLERANCES = Tolerances(
    settle_position=SETTLE_POSITION,
    late_position=LEFT_ALONE,
    settle_velocity=SETTLE_VELOCITY,
    settle_timeout=SETTLE_TIMEOUT,
    following_lag=0.15,
    contact_distance=to_rad(1.6),
    pressed_stray=to_rad(0.4),
)
"""When a real arm has arrived; its servos are up to 0.1 s behind at speed. Without contact a joint
fell short of its setpoints by at most 1.3 deg in 0.08 s, on arms that differ, with up to 0.3 kg in
the hand. A slow joint stands where its load changes sides until its motor has crossed the play
(``servo_model.py``); if its load stays on one side, it was less than 0.3 deg off."""

DROOPING_TOLERANCES = replace(
    HARDWARE_TOLERANCES,
    settle_position=to_rad(6.0),
    late_position=to_rad(6.0),
    following_error=to_rad(12.0),
    following_lag=0.3,
    contact_distance=math.inf,
    pressed_stray=math.inf,
)
"""The same where weight and lag are not compensated: the elbow was seen to droop by 4 deg. A
contact is noticed later, from how far a joint is off. Chosen."""

JAW_TOLERANCES = Tolerances(
    settle_position=to_rad(1.0),
    settle_velocity=SETTLE_VELOCITY,
    settle_timeout=0.4,
    following_error=0.08,
    following_lag=0.15,
)
"""The same for a real jaw. Its standing error of some ticks is not corrected, and an object that it
closes on must stop it soon: 0.08 rad are 5 mm between the tips. Chosen."""

HARDWARE_JAW_LIMITS = MotionLimits.uniform(
    velocity=to_rad(90.0), acceleration=10.0, jerk=200.0, n=1
)
"""Caps of a real jaw: this speed takes a third of its drive, so half of it is enough, and it is
slow enough to notice an object. Chosen."""

KEPT_UP = 0.93
"""Share of a servo's acceleration that motions may use. Chosen: the rest is for catching up, and
the shoulder, the slowest by measurement, keeps 430 deg/s^2."""

WAY_WITHIN = 5.0
"""How long the way home or to the park pose may take when the process ends [s]. Chosen: viam-server
kills a module after 10 s, and planning, lowering and closing take their part."""

_CALM = (Mode.HOLDING, Mode.LIMP, Mode.FAULT)
"""Modes in which servos may be set up again unasked: never while the arm is guided by hand."""


def arm_weight(model: RobotModel) -> ArmWeight:
    """The weight of the arm, and of what its gripper carries."""
    bodies, gravity = model.moved_bodies()
    loaded, _ = model.with_payload(1.0, place_in_hand(model)).moved_bodies()
    return ArmWeight(bodies, loaded, gravity)


class SharedPort:
    """The rig of a port and its users. ``hardware_rig.py`` calls its methods one at a time.

    ``settings`` are those of its first user. Answers are waited for ``reply_timeout`` [s]; None for
    as long as the period of the setpoints allows. Servos are found before this returns if it
    ``waits``, else soon after.

    ``shares`` are the settings of each component that uses it; ``is_closing`` is whether the last
    one is leaving; ``failures`` records the second before a failure.
    """

    def __init__(
        self,
        settings: ServoSettings,
        clock: Clock,
        reply_timeout: float | None,
        open_port: PortOpener | None = None,
        *,
        waits: bool,
    ) -> None:
        self.shares: list[ServoSettings] = []
        self.is_closing = False
        self._has_left = False
        self._holding: Future[None] = Future()  # of servos that have just been found
        self._holding.set_result(None)
        self._trouble: str | None = None  # why what is asked for is not in force
        self._put_off: list[ServoSettings] = []  # shares whose settings could not be taken up
        dt = 1.0 / settings.rate if settings.rate else TICK
        self._device = os.path.realpath(settings.port)
        weight = arm_weight(RobotModel.load())
        self.servos = ServoDriver(
            settings,
            clock,
            gravity=weight,
            per_kg=weight.per_kg,
            reply_timeout=reply_timeout_in(dt) if reply_timeout is None else reply_timeout,
            open_port=open_port,
        )
        if waits:
            self.servos.connect()
        else:
            self.servos.probe()
            if not settings.required():
                self.servos.monitor_only()
        self.rig = Rig(
            self.servos,
            clock=clock,
            speed=to_rad(50.0),
            acceleration=to_rad(100.0),
            scene=Scene(),
            dt=dt,
            tolerances=HARDWARE_TOLERANCES
            if settings.compensates is not False
            else DROOPING_TOLERANCES,
            jaw_tolerances=JAW_TOLERANCES,
            start=Executor.start if waits and settings.required() else Executor.start_limp,
        )
        self.servos.on_found = self._on_found
        self.failures = FailureRecorder(settings.port)
        self.rig.executor.on_failure(self.failures.record)
        if isinstance(clock, MonotonicClock):
            self.rig.executor.call(lambda _: use_realtime_priority())
        self.rig.gripper.limits = HARDWARE_JAW_LIMITS
        self.rig.arm.slowdown = lambda: self.servos.speed_share
        self.rig.arm.drive = lambda: self.servos.drive
        self.take_ranges()

    def leave_as_configured(self) -> None:
        settings = self.servos.settings
        if settings.at_end is None or self._has_left:
            return
        self._has_left = True
        try:
            leave(self.rig, settings.at_end, self.servos.encoder_zeros, within=WAY_WITHIN)
        except So101Error as error:
            _log.warning(
                "the arm on %s holds at the end instead of %s: %s",
                *(settings.port, settings.at_end, error),
            )

    def is_on(self, port: str) -> bool:
        device = os.path.realpath(port)
        return device in (self._device, os.path.realpath(self.servos.settings.port))

    def take_ranges(self) -> None:
        """Set ranges, strength, acceleration and stop of arm and gripper as the servos allow."""
        arm = [self.servos.setups.get(joint) for joint in ARM_JOINTS]
        self.rig.arm.set_range(
            np.array([-math.inf if each is None else each.map.lower for each in arm]),
            np.array([math.inf if each is None else each.map.upper for each in arm]),
        )
        models = [self.servos.models[j] for j in ARM_JOINTS if j in self.servos.models]
        if models:
            brakes = np.array([each.braking for each in models])
            self.rig.arm.servo_acceleration = KEPT_UP * brakes
            stop = HARD_STOP.lowered_to(HARD_STOP.velocity, brakes)  # or joints swing past its end
            self.rig.executor.set_stop_limits(stop)
            self.rig.arm.set_servo_strength([each.figures.torque for each in models])
        jaw = self.servos.setups.get(GRIPPER_JOINT)
        self.rig.gripper.is_there = jaw is not None or not self.servos.setups
        if jaw is not None:
            self.rig.gripper.closed, self.rig.gripper.opened = jaw.map.lower, jaw.map.upper

    def close(self) -> None:
        self.rig.close()
        self.failures.close()

    # Letting another component in

    def join(self, settings: ServoSettings) -> ServoSettings:
        """Combine ``settings`` with those of all others; ``ConfigError`` if they contradict."""
        shares = [*self.shares, settings]
        joined = self._combined(shares)
        running = 1.0 / self.rig.executor.dt
        if joined.rate is not None and abs(joined.rate - running) > 1e-6:
            raise ConfigError(
                "control_rate_hz",
                joined.rate,
                f"the port already runs at {running:g} Hz; give every component on it the same"
                " rate, or restart the module",
            )
        warning = about_unused_file(shares)
        if warning is not None:
            _log.warning("%s", warning)
        return joined

    def admit(self, joined: ServoSettings) -> None:
        """Use the settings ``joined``; sets up the servos if that is needed.

        While the bus is lent, they are set up when it is given back.
        """
        if self.rig.executor.state.lent_to is None and self._differs(joined):
            self.rebuild(joined)
        self.servos.settings = joined

    def replace(self, before: ServoSettings, after: ServoSettings) -> None:
        """Let a component ask for other settings; if that fails, all is as before."""
        others = list(self.shares)
        others[others.index(before)] = after
        self.admit(self._combined(others))
        self.shares = others

    def leave(self, settings: ServoSettings) -> bool:
        """Give up a share; returns whether it was the last one."""
        self.shares.remove(settings)
        self.is_closing = not self.shares
        if self.shares:
            self.servos.settings = self._combined(self.shares)
        return self.is_closing

    def _combined(self, shares: Sequence[ServoSettings]) -> ServoSettings:
        """The settings of ``shares``; the port keeps the name by which it was opened."""
        return replace(combined(shares), port=self.servos.settings.port)

    def rebuild(self, settings: ServoSettings) -> None:
        """Set the servos up again; all joints are held where they are."""
        executor, first = self.rig.executor, not self.servos.in_force.required()
        executor.call_and_rehold(lambda _: self._rebuild(settings)).result()
        if first and settings.required():
            executor.hold().result()
        self.rig.gripper.regrip()

    def _rebuild(self, settings: ServoSettings) -> None:
        self.servos.rebuild(settings)
        self.take_ranges()

    def _differs(self, wanted: ServoSettings) -> bool:
        """Whether the servos have to be set up anew for ``wanted``."""
        if self.servos.is_ours and not wanted.required():
            return False  # they are driven on as those who asked for them left them
        now, ids = self.servos.in_force, wanted.ids()
        in_use = {joint: setup.map.servo_id for joint, setup in self.servos.setups.items()}
        return (
            not now.required()
            or wanted.baudrate != now.baudrate
            or wanted.file != now.file
            or wanted.zero_offsets != now.zero_offsets
            or wanted.joint_zero != now.joint_zero
            or any(joint not in in_use for joint in wanted.required())
            or any(ids.get(joint) != servo_id for joint, servo_id in in_use.items())
        )

    @property
    def _is_in_force(self) -> bool:
        wanted, servos = self.servos.settings, self.servos
        if servos.in_force == wanted:
            return all(joint in servos.setups for joint in wanted.required())
        return not self._differs(wanted)

    @property
    def _is_outdated(self) -> bool:
        """Whether the servos are used with other settings than those now asked for."""
        servos = self.servos
        return servos.is_found and self._differs(_of_arm(servos.settings))

    # Without waiting

    def not_ready(self, share: ServoSettings) -> str | None:
        """Why ``share`` cannot be used yet; None once its servos have been found and set up."""
        servos = self.servos
        if (why := servos.why_not_found) is not None:
            return why
        if self.rig.executor.state.reading is servos.no_reading or not self._holding.done():
            return "the servos have just been found; try again"
        if share in self._put_off and self._is_outdated:
            return f"{self._trouble} (every request tries again)"
        missing = [joint for joint in share.required() if joint not in servos.setups]
        if not missing:
            return None
        first, ids = missing[0], servos.settings.ids()
        plain = f"servo {ids[first]} ({first}) did not answer; check its cable"
        return f"{self._trouble or plain} (every request tries again)"

    def set_up_soon(self, share: ServoSettings) -> Future[None]:
        """Have the port's thread set the servos up, unless they are.

        ``share`` is not ready until its settings are in force. The future is done when that was
        tried once, successfully or not.
        """
        tried: Future[None] = Future()
        ask = self.rig.executor.ask

        def go_on(_: Future[None]) -> None:  # in a cycle of its own, so that the state shows it
            ask(self._set_up).add_done_callback(end)

        def end(setting_up: Future[None]) -> None:
            error = setting_up.exception()
            self._trouble = None if error is None else str(error)
            if error is None:
                self._put_off = []
            elif self._is_outdated and share not in self._put_off:
                self._put_off = [*self._put_off, share]
                _log.warning("new settings are not in force yet: %s", error)
            self._holding.add_done_callback(lambda _: tried.set_result(None))

        ask(self._forget).add_done_callback(go_on)
        return tried

    def _forget(self, control: JointController) -> None:
        """Stop monitoring if there are servos to be driven now."""
        servos = self.servos
        if (
            control.mode in (Mode.LIMP, Mode.FAULT)
            and not servos.is_ours
            and servos.settings.required()
        ):
            servos.forget()

    def _set_up(self, control: JointController) -> None:
        servos = self.servos
        if control.mode is Mode.CALIBRATING:
            return  # it is set up when the bus comes back
        if not servos.is_found:
            servos.find()
        elif not self._is_in_force:
            if control.mode not in _CALM:
                raise MotionError(
                    f"the arm on {servos.settings.port} is {control.mode.value}, so nothing else on"
                    " the port can be set up; stop it or wait for its end"
                )
            self._set_up_anew(control, servos.settings)
            self.rig.gripper.regrip()

    def _set_up_anew(self, control: JointController, wanted: ServoSettings) -> None:
        """Set the servos up again; a silent jaw does not keep its arm from new settings."""
        arm = _of_arm(wanted)
        try:
            control.call_and_rehold(lambda _: self._rebuild(wanted))
        except NoReply:
            if arm != wanted and self._differs(arm):
                control.call_and_rehold(lambda _: self._rebuild(arm))
            raise

    def _on_found(self) -> None:
        """Hold the servos where they stand, now that they have been found."""
        self.take_ranges()
        _log.info("the servos on %s have been found", self.servos.settings.port)
        self._holding = self.rig.executor.hold()


def _of_arm(settings: ServoSettings) -> ServoSettings:
    """``settings`` without the gripper that is on an arm; those of a gripper alone as they are."""
    return settings if settings.servo_ids is None else replace(settings, gripper_id=None)
