"""Answer the arm's commands about its servos: ping, diagnose, calibration, torque.

Keys and answers are the published module's. Its ``diagnose``, ``verify_config`` and
``reinitialize`` could not succeed in a running module; here they can. Commands that talk to the
servos run on the I/O thread and are refused while the arm moves.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from so101_motion.calib.motors.arm_identification import look
from so101_motion.calib.record import store
from so101_motion.common.attributes import Attributes
from so101_motion.common.errors import ConfigError, MotionError, NoReply, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, JointReading, lent_out
from so101_motion.common.units import to_deg
from so101_motion.control.limit_recovery import remarks
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.servo_driver import ServoDriver
from so101_motion.setup.diagnosis import explain, label
from so101_motion.viam.requests.await_motion import run_to_end
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


class ServoCommands:
    """Answers the requests about servos."""

    def __init__(self, rig: HardwareRig, servo_ids: tuple[int, ...], manual: ManualMode) -> None:
        self._rig, self._ids, self._manual = rig, servo_ids, manual
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
        if self._rig.arm.state.mode in (Mode.MOVING, Mode.STOPPING):
            silent = [joint for joint in self._rig.servos.health if joint.is_silent]
            for joint in silent:
                raise NoReply(
                    f"no reply from servo {joint.servo_id} ({joint.joint}); check its cable",
                    servo_id=joint.servo_id,
                    register="a ping",
                )
        else:
            await on_bus(self._rig, _ping_all)
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
            names = {i: joint for joint, i in servos.settings.ids().items()}
            absent = {names[i] for i in names if names[i] not in servos.setups}
            names = {i: joint for i, joint in names.items() if joint not in absent}
            turned = {s.map.servo_id for s in servos.setups.values() if s.map.direction < 0}
            seen = await on_bus(self._rig, lambda servos: look(servos.bus, names, turned))
        except So101Error as error:
            why = self._rig.not_ready or str(error)
            return {"success": False, "error": why, "findings": [why]}
        trouble = explain(seen, names, dict(servos.bus.counters))
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


def _ping_all(servos: ServoDriver) -> None:
    bus = servos.bus
    for setup in servos.setups.values():
        bus.ping(setup.map.servo_id)


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
