"""``so101 status``: print the state of an arm; and ``so101 stop``: stop a machine's arm."""

from __future__ import annotations

import time
from contextlib import closing
from typing import TYPE_CHECKING, Any

import click

from so101_motion.cli.options import JSON, verb
from so101_motion.cli.shared import answer, echo, print_json, quietly
from so101_motion.cli.sources import ANY_SOURCE, MACHINE, AnySource, MachineSource, Source
from so101_motion.common.errors import CalibrationError
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import range_deg, to_deg, to_mm, to_rad

if TYPE_CHECKING:
    from so101_motion.rig.hardware_rig import HardwareRig
    from so101_motion.rig.protocols import RigLike

_PATIENCE = 1.0  # how long to wait for a first answer of the servos [s]; chosen for a busy computer
_AT_LIMIT = to_rad(0.5)  # a joint this far outside its limits still is at them [rad]; chosen


@verb()
def status(source: AnySource = ANY_SOURCE, as_json: bool = JSON) -> None:
    """Show the arm's mode, its joints, and where its tool is.

    It only reads: a limp arm stays limp, and one that holds goes on holding.

    \b
    so101 status --port /dev/ttyACM0
    so101 status --machine my-arm.local:8080 --json
    """  # noqa: D301
    from so101_motion.rig.hardware_rig import HardwareRig

    with quietly(), closing(_open_to_read(source)) as rig:
        seen = _facts(source, rig)
    found = seen.get("joints_found", ARM_JOINTS)
    if found and as_json:
        print_json("status", seen)
    elif found:
        _print_state(seen)
    silent = [joint for joint in ARM_JOINTS if joint not in found]
    if silent and isinstance(rig, HardwareRig):
        rig.servos.require(silent)  # says what to check


@verb()
def stop(machine: MachineSource | None = MACHINE, as_json: bool = JSON) -> None:
    """Stop the arm and the jaw of a running machine, whichever program moves them.

    They hold where they come to rest. To stop an arm on a serial port of this computer, press
    Ctrl-C in the program that moves it, or Stop on its page.

    \b
    so101 stop --machine my-arm.local:8080
    """  # noqa: D301
    if machine is None:
        raise click.UsageError(
            "give --machine and its address; to stop an arm on a serial port, press Ctrl-C in the"
            " program that moves it"
        )
    with quietly(), closing(machine.open()) as rig:
        rig.arm.stop()
        if rig.has_gripper:
            rig.gripper.stop()
        state = rig.arm.state
    what, mode = machine.what, state.mode.value
    facts = {"source": what, "mode": mode, "q_deg": _by_joint(to_deg(state.q))}
    answer(as_json, "stop", facts, f"the {what} is {mode}")


def _open_to_read(source: AnySource) -> RigLike:
    """Open the arm without moving or holding it."""
    if not isinstance(source, Source) or source.port is None:
        return source.open()
    from so101_motion.calib.record.record import NEW_IDS, misplaced
    from so101_motion.cli.port_choice import look_at
    from so101_motion.rig.hardware_rig import open_hardware
    from so101_motion.rig.port_settings import ServoSettings

    report = look_at(source.port)
    if wrong := misplaced(report.servo_ids, {}):
        raise CalibrationError(None, wrong, NEW_IDS)
    file = source.calibration_file or report.calibration
    settings = ServoSettings(
        port=source.port, baudrate=report.baudrate, timeout=None, calibration_file=file
    )
    return open_hardware(settings)


def _facts(source: AnySource, rig: RigLike) -> dict[str, Any]:
    from so101_motion.drivers.feetech.servo_judgement import alarms
    from so101_motion.rig.hardware_rig import HardwareRig
    from so101_motion.viam.client import MachineRig

    holds = isinstance(rig, HardwareRig) and is_held(rig)
    state, arm = rig.arm.state, rig.arm
    pose = arm.T_base()
    found: tuple[str, ...] = (*ARM_JOINTS, GRIPPER_JOINT)
    if isinstance(rig, HardwareRig):  # those that answer now, in order
        found = tuple(j for j in found if j in (rig.servos.positions or rig.servos.setups))
    q_deg: dict[str, Any] = _by_joint(to_deg(state.q))
    has_arm = all(joint in found for joint in ARM_JOINTS)
    lower, upper = arm.range
    is_outside = (state.q < lower - _AT_LIMIT) | (state.q > upper + _AT_LIMIT)
    floor_z = arm.scene.floor_z
    seen: dict[str, Any] = {
        "source": source.what,
        "connected": rig.connection.is_up,
        "mode": state.mode.value,
        "fault": state.fault or "",
        "q_deg": {joint: q if joint in found else None for joint, q in q_deg.items()},
        "range_deg": _by_joint(to_deg(lower), to_deg(upper)),
        "outside_limits": [j for j, is_so in zip(ARM_JOINTS, is_outside, strict=True) if is_so],
        "jaw_percent": (
            round(100.0 * rig.gripper.aperture, 1)
            if GRIPPER_JOINT in found and GRIPPER_JOINT not in state.reading.silent
            else None
        ),
        "tool_mm": [round(x, 2) for x in to_mm(pose.p).tolist()] if has_arm else None,
        "tool_below_floor": has_arm and floor_z is not None and bool(pose.p[2] < floor_z),
        "speed_degs_per_sec": round(to_deg(arm.speed), 3),
        "acceleration_degs_per_sec_per_sec": round(to_deg(arm.acceleration), 3),
        "alarms": dict(state.reading.alarms),
        "notes": [],
    }
    if isinstance(rig, HardwareRig):
        seen["joints_found"] = list(found)
        seen["alarms"] |= alarms(rig.servos.health)
        seen["notes"] = list(rig.servos.notes)
        if holds:  # since before; this program only reads
            seen["mode"] = Mode.HOLDING.value
            seen["notes"] += [f"the arm {state.torque}"] if "limp" in state.torque else []
    elif isinstance(rig, MachineRig):
        notes = rig.status.get("notes", ())
        seen["notes"] = [str(note) for note in notes] if isinstance(notes, list) else []
        seen["resources"] = [{"name": r.name, "api": r.api} for r in rig.resources]
    return seen


def is_held(rig: HardwareRig) -> bool:
    """Whether any servo holds its joint; waits a moment for the first answer."""
    latest = time.monotonic() + _PATIENCE
    while rig.servos.holds is None and time.monotonic() < latest:
        time.sleep(0.02)
    return bool(rig.servos.holds)


def _by_joint(*columns: Any) -> dict[str, Any]:
    rounded = [[round(float(x), 3) for x in column] for column in columns]
    rows = rounded[0] if len(rounded) == 1 else [list(row) for row in zip(*rounded, strict=True)]
    return dict(zip(ARM_JOINTS, rows, strict=True))


def _print_state(seen: dict[str, Any]) -> None:
    click.echo(f"{seen['source']}: {seen['mode']}")
    if seen["fault"]:
        echo(seen["fault"], indent="  ")
    found = seen.get("joints_found", (*ARM_JOINTS, GRIPPER_JOINT))
    for joint in ARM_JOINTS:
        if joint not in found:
            click.echo(f"  {joint:<14}does not answer")
            continue
        lower, upper = map(to_rad, seen["range_deg"][joint])
        between, q_deg = range_deg(lower, upper, 0), seen["q_deg"][joint]
        if joint in seen["outside_limits"]:
            between += ", outside its limits"
        click.echo(f"  {joint:<14}{q_deg:>z8.1f} deg   {between}")
    if seen["jaw_percent"] is None:
        click.echo(f"  {'jaw':<14}does not answer")
    else:
        click.echo(f"  {'jaw':<14}{seen['jaw_percent']:>8.0f} % open")
    if seen["tool_mm"] is None:
        click.echo(f"  {'tool':<14}not known")
    else:
        where = ", ".join(f"{x:.1f}" for x in seen["tool_mm"])
        below = ", below the table" if seen["tool_below_floor"] else ""
        click.echo(f"  {'tool':<14}({where}) mm{below}")
    alike: dict[str, list[str]] = {}
    for joint, words in seen["alarms"].items():
        alike.setdefault(words, []).append(joint)
    for words, joints in alike.items():  # one line for one weak supply
        echo(f"{', '.join(joints) if len(joints) < 6 else 'all servos'}: {words}", err=True)
    for note in seen["notes"]:
        echo(f"note: {note}", err=True)
