"""Answer the arm's commands about its servos: ping, diagnose, calibration, torque, the jaw.

Keys and answers are the published module's. Its ``diagnose``, ``verify_config`` and
``reinitialize`` could not succeed in a running module; here they can. Commands that talk to the
servos run on the I/O thread and are refused while the arm moves.

With the ``servo_…`` commands of its later versions programs move the jaw through the arm when no
gripper is configured. If a gripper component moves the same jaw, the newer motion takes over.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from so101_motion.arm.motion_handle import Motion
from so101_motion.calib.motors.arm_identification import look
from so101_motion.calib.record import store
from so101_motion.common.attributes import Attributes
from so101_motion.common.errors import (
    ConfigError,
    MotionError,
    NoReply,
    PortUnavailable,
    So101Error,
)
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT, JointReading, lent_out
from so101_motion.common.units import to_deg
from so101_motion.control.limit_recovery import remarks
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.servo_driver import ServoDriver
from so101_motion.setup.checkup import explain, label
from so101_motion.viam.requests.await_motion import log_failure_of, run_to_end
from so101_motion.viam.requests.commands import Command, Taking
from so101_motion.viam.requests.manual import ManualMode

T = TypeVar("T")


async def on_bus(rig: HardwareRig, job: Callable[[ServoDriver], T]) -> T:
    """Run ``job`` with the servos on the I/O thread; refused while the arm moves."""
    return await asyncio.wrap_future(rig.executor.call(lambda _: job(rig.servos)))


async def ready(rig: HardwareRig) -> None:
    """Check that the servos have been found; tries a missing one again.

    A component starts before its servos are found. This waits for the first try, which takes a
    moment; later calls return at once. ``NotReady`` names the silent ones and since when.
    """
    if not rig.first_try.done():
        await asyncio.shield(asyncio.wrap_future(rig.first_try))
    if rig.not_ready is not None and rig.servos.is_found:
        await asyncio.shield(asyncio.wrap_future(rig.look_again()))
    rig.require_ready()


def require_connected(rig: HardwareRig) -> None:
    """Refuse to say where the joints are while the port is away: all that is known is old."""
    if not rig.servos.is_connected:
        reason = "the adapter is not there, so where the joints are is not known; plug it in again"
        raise PortUnavailable(rig.settings.port, reason)


async def out_of_fault(rig: HardwareRig) -> None:
    """Let the arm hold again after a fault, before a request that moves it."""
    state = rig.arm.state
    if state.lent_to is not None:
        raise MotionError(lent_out(state.lent_to))
    await ready(rig)
    state = rig.arm.state
    if state.mode is Mode.FAULT:
        await asyncio.wrap_future(rig.executor.hold())
        rig.gripper.regrip()


def controller(rig: HardwareRig) -> dict[str, Any]:
    settings, servos = rig.servos.settings, rig.servos
    sources = sorted({setup.source for setup in servos.setups.values()})
    text = f"{settings.port}@{settings.baudrate}(refs:{rig.users},cal:{'/'.join(sources)})"
    return {
        "ref_count": rig.users,
        "has_controller": True,
        "config": f"Controllers: [{text}]",
        "connected": servos.is_connected,
        "port_losses": servos.port_losses,
    }


def health(servos: ServoDriver) -> dict[str, Any]:
    return {
        joint.joint: {
            "servo_id": joint.servo_id,
            "silent": joint.is_silent,
            "volts": round(joint.volts, 1),
            "amps": round(joint.amps, 3),
            "temperature_c": joint.temperature_c,
            "load_percent": round(100.0 * joint.load, 1),
            "faults": list(joint.faults),
            "faults_since_start": list(joint.latched),
            "answers": joint.answers,
            "lost": joint.lost,
            "corrupt": joint.corrupt,
            "retries": joint.retries,
        }
        for joint in servos.health
    }


def out_of_range(reading: JointReading) -> dict[str, dict[str, float]]:
    """The joints outside their calibrated range: where each is, and where it comes back inside."""
    here = reading.angles
    return {
        joint: {"at_deg": to_deg(here[joint]), "limit_deg": to_deg(limit)}
        for joint, limit in reading.out_of_range.items()
    }


_PATIENCE_MS = 3000.0
"""How long ``servo_wait_stop`` waits without ``timeout_ms`` [ms]; the published default."""

_LOOK = 0.02  # time between two checks while it waits [s]


class ServoCommands:
    """Answers the requests about servos."""

    def __init__(
        self,
        rig: HardwareRig,
        servo_ids: tuple[int, ...],
        manual: ManualMode,
        logger: logging.Logger,
    ) -> None:
        self._rig, self._ids, self._manual, self._logger = rig, servo_ids, manual, logger
        self._latest: Motion | None = None  # of the jaw
        self.commands: Mapping[str, Command] = {
            "set_torque": Taking(self._set_torque, ("enable",)),
            "ping": self._ping,
            "controller_status": self._controller_status,
            "diagnose": self._diagnose,
            "verify_config": self._verify_config,
            "write_calibration": self._write_calibration,
            "reinitialize": Taking(self._reinitialize, ("retries",)),
            "test_servo_communication": self._test_servo_communication,
            "reload_calibration": self._reload_calibration,
            "get_calibration": self._get_calibration,
            "health": self._health,
            "set_torque_limit": Taking(self._set_torque_limit, ("value",)),
            "servo_capabilities": self._capabilities,
            "servo_move": Taking(self._move_jaw, ("servo_id", "percent", "raw", "speed")),
            "servo_moving": Taking(self._jaw_moving, ("servo_id",)),
            "servo_position": Taking(self._jaw_position, ("servo_id",)),
            "servo_stop": Taking(self._stop_jaw, ("servo_id",)),
            "servo_wait_stop": Taking(self._wait_for_jaw, ("servo_id", "timeout_ms")),
        }

    # Torque

    async def _set_torque(self, given: Attributes) -> dict[str, Any]:
        if not given.given("enable"):
            raise ConfigError("enable", None, "is missing; true to hold, false to release")
        enable = given.flag("enable", True)
        self._manual.forget()
        if enable:
            await out_of_fault(self._rig)
        await run_to_end(lambda: self._rig.arm.set_torque(enable))
        return {"success": True}

    async def _set_torque_limit(self, given: Attributes) -> dict[str, Any]:
        value = given.required("value", lower=0.0, upper=1000.0)

        def limit(servos: ServoDriver) -> None:
            for joint in ARM_JOINTS:
                servos.set_torque_limit(joint, value / 1000.0)

        await on_bus(self._rig, limit)
        return {
            "set_torque_limit": value,
            "servos": [{"servo": i, "ok": True, "readback": value} for i in self._ids],
            "note": "kept until the servos are set up again; 1000 is full drive",
        }

    # State

    async def _ping(self) -> dict[str, Any]:
        def ping_all(servos: ServoDriver) -> None:
            for setup in servos.setups.values():
                servos.bus.ping(setup.map.servo_id)

        if self._rig.arm.state.mode in (Mode.MOVING, Mode.STOPPING):
            for joint in self._rig.servos.health:
                if joint.is_silent:
                    raise NoReply(
                        f"no reply from servo {joint.servo_id} ({joint.joint}); check its cable",
                        servo_id=joint.servo_id,
                        register="a ping",
                    )
        else:
            await on_bus(self._rig, ping_all)
        return {"success": True}

    async def _controller_status(self) -> dict[str, Any]:
        return {**controller(self._rig), "arm_servo_ids": list(self._ids)}

    async def _health(self) -> dict[str, Any]:
        servos, state = self._rig.servos, self._rig.arm.state
        return {
            "connected": servos.is_connected,
            "port_losses": servos.port_losses,
            "late_ticks": state.late_ticks,
            "fault": state.fault or "",
            "joints": health(servos),
        }

    async def _diagnose(self) -> dict[str, Any]:
        servos = self._rig.servos
        try:
            ids = {j: i for j, i in servos.settings.ids().items() if j in servos.setups}
            names = {i: joint for joint, i in ids.items()}
            turned = {s.map.servo_id for s in servos.setups.values() if s.map.direction < 0}
            seen = await on_bus(self._rig, lambda servos: look(servos.bus, names, turned))
        except So101Error as error:
            why = self._rig.not_ready or str(error)
            return {"success": False, "error": why, "findings": [why]}
        trouble = explain(seen, ids, dict(servos.bus.counters))
        findings = [*trouble, *servos.notes, *remarks(self._rig.arm.state.reading)]
        if servos.port_losses:
            findings.append(
                f"the port went away {servos.port_losses} times since the start; check the USB"
                " cable and plug it straight into the computer"
            )
        return {
            "success": not trouble,
            "error": "; ".join(trouble),
            "findings": findings,
            "servos_found": sorted({*seen.servos, *seen.shared}),
            "registers": {
                label(i, names): dict(facts.held) for i, facts in seen.servos.items() if i in names
            },
            "joints": health(servos),
        }

    async def _verify_config(self) -> dict[str, Any]:
        try:
            differing = await on_bus(self._rig, _differing)
        except So101Error as error:
            return {"success": False, "error": str(error)}
        return {"success": not differing, "error": "; ".join(differing)}

    async def _test_servo_communication(self) -> dict[str, Any]:
        answer: dict[str, Any] = {"arm_servo_ids": list(self._ids)}
        try:
            if self._rig.arm.state.mode not in (Mode.MOVING, Mode.STOPPING):
                reading = await on_bus(self._rig, lambda servos: servos.read())
            else:
                reading = self._rig.arm.state.reading
        except So101Error as error:
            return {"success": False, **answer, "error": str(error)}
        return {"success": True, **answer, "positions": [float(q) for q in reading.q]}

    # Setting up

    async def _reinitialize(self, given: Attributes) -> dict[str, Any]:
        retries = round(given.number("retries", 3.0, lower=1.0, upper=20.0))
        problem: So101Error | None = None
        for _ in range(retries):
            try:
                await run_to_end(self._rig.reload)
                await out_of_fault(self._rig)
                await asyncio.wrap_future(self._rig.executor.hold())
            except So101Error as error:
                problem = error
            else:
                return {"success": True, "error": "", "retries": retries}
        return {"success": False, "error": str(problem), "retries": retries}

    async def _reload_calibration(self) -> dict[str, Any]:
        file = self._rig.servos.settings.file
        try:
            if file is None:
                raise ConfigError(
                    "calibration_file",
                    None,
                    "is not configured, so there is no file to reload; configure one, or send"
                    ' "reinitialize" to read the servos\' registers again',
                )
            found = await asyncio.to_thread(store.load, file)
            await run_to_end(self._rig.reload)
        except So101Error as error:
            return {"success": False, "error": str(error)}
        loaded = f"calibration of {len(found.calibration)} joints loaded; the arm did not move"
        message = "; ".join((loaded, *found.notes))
        return {"success": True, "calibration_file": str(file), "message": message}

    async def _write_calibration(self) -> dict[str, Any]:
        kept = await run_to_end(self._rig.write_calibration)
        return {"success": True, "kept": "" if kept is None else str(kept)}

    async def _get_calibration(self) -> dict[str, Any]:
        setups, file = self._rig.servos.setups, self._rig.servos.settings.file
        return {
            "success": True,
            "calibration": {j: setup.calibration.to_json() for j, setup in setups.items()},
            "source": {joint: setup.source for joint, setup in setups.items()},
            "zero": {
                joint: {"by": setup.zero.by, "middle_deg": to_deg(setup.zero.angle)}
                for joint, setup in setups.items()
                if joint in ARM_JOINTS
            },
            "calibration_file": str(file or ""),
        }

    # The jaw

    async def _capabilities(self) -> dict[str, Any]:
        return {
            "servo_commands": True,
            "servo_ids": [self._jaw_id] if GRIPPER_JOINT in self._rig.servos.setups else [],
        }

    async def _move_jaw(self, given: Attributes) -> dict[str, Any]:
        self._check_jaw(given)
        jaw = self._rig.gripper
        echo: dict[str, Any]
        if given.given("raw"):
            raw = given.required("raw", lower=0.0, upper=4095.0, unit="ticks")
            q = self._rig.servos.to_angle(GRIPPER_JOINT, round(raw))
            aperture, echo = (q - jaw.closed) / (jaw.opened - jaw.closed), {"raw": raw}
        else:
            percent = given.required("percent", unit="%")
            aperture, echo = percent / 100.0, {"percent": min(max(percent, 0.0), 100.0)}
        aperture = min(max(aperture, 0.0), 1.0)  # limited, as in the published module
        limits = jaw.limits
        if given.given("speed"):
            ticks = given.required("speed", lower=1.0, upper=4096.0, unit="ticks/s")
            asked = np.full(1, 2.0 * np.pi * ticks / 4096.0)
            limits = replace(limits, velocity=np.minimum(asked, limits.velocity))
        await out_of_fault(self._rig)
        # An object in the way of a closing jaw is gripped, not crushed.
        go = jaw.grab if aperture < jaw.aperture else jaw.move
        self._latest = go(aperture, limits=limits, wait=False)
        log_failure_of(self._latest, self._logger)
        return echo

    async def _jaw_moving(self, given: Attributes) -> dict[str, Any]:
        self._check_jaw(given)
        return {"moving": self._jaw_is_moving()}

    async def _jaw_position(self, given: Attributes) -> dict[str, Any]:
        self._check_jaw(given)
        jaw = self._rig.gripper
        raw = self._rig.servos.to_ticks(GRIPPER_JOINT, jaw.q_jaw)
        return {"percent": round(100.0 * min(max(jaw.aperture, 0.0), 1.0), 3), "raw": raw}

    async def _stop_jaw(self, given: Attributes) -> dict[str, Any]:
        self._check_jaw(given)
        await asyncio.wrap_future(self._rig.gripper.start_stop())
        return {}

    async def _wait_for_jaw(self, given: Attributes) -> dict[str, Any]:
        self._check_jaw(given)
        patience_ms = given.number("timeout_ms", _PATIENCE_MS, lower=0.0, upper=6e5, unit="ms")
        waited_ms = 0.0
        while self._jaw_is_moving():
            if waited_ms >= patience_ms:
                raise MotionError(
                    f"servo {self._jaw_id} still moves after {patience_ms:g} ms; raise"
                    " timeout_ms, or send servo_stop"
                )
            await asyncio.sleep(_LOOK)
            waited_ms += 1000.0 * _LOOK
        return {}

    def _jaw_is_moving(self) -> bool:
        begun = self._latest is not None and not self._latest.future.done()
        return begun or self._rig.gripper.is_moving

    @property
    def _jaw_id(self) -> int:
        return self._rig.settings.ids()[GRIPPER_JOINT]

    def _check_jaw(self, given: Attributes) -> None:
        asked = given.required("servo_id", lower=1.0, upper=6.0)
        if asked != self._jaw_id:
            reason = f"moves the arm, not the jaw; give {self._jaw_id}, the jaw's servo"
            raise ConfigError("servo_id", asked, reason)
        if GRIPPER_JOINT not in self._rig.servos.setups:
            raise ConfigError(
                "servo_id",
                asked,
                "did not answer when the arm was opened; check its cable, then send reinitialize",
            )


def _differing(servos: ServoDriver) -> list[str]:
    """The servos whose settings differ from the calibration in use or from position control."""
    names = {s.map.servo_id: joint for joint, s in servos.setups.items()}
    seen = look(servos.bus, names)
    found = []
    for joint, setup in servos.setups.items():
        facts = seen.servos.get(setup.map.servo_id)
        if facts is None:
            found.append(f"no answer from {label(setup.map.servo_id, names)}")
            continue
        wanted: dict[str, int | None] = {"operating_mode": 0}
        if setup.source == "file":
            wanted |= {
                "homing_offset": setup.map.homing_offset,
                "min_position": setup.calibration.range_min,
                "max_position": setup.calibration.range_max,
            }
        found += [
            f"{joint}: {name} is {facts.held[name]}, not {value}"
            for name, value in wanted.items()
            if facts.held[name] != value
        ]
    return found
