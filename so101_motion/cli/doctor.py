"""``so101 doctor``: check the installation, the port, the servos and the calibration."""

from __future__ import annotations

import json
import time
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from so101_motion import __version__
from so101_motion.cli import port_choice
from so101_motion.cli.options import JSON, flag, option, verb
from so101_motion.cli.param_types import OutFile, port_option
from so101_motion.cli.shared import (
    CHECK_FAILED,
    aside,
    busy_message,
    echo,
    print_json,
    quietly,
    write_report,
)
from so101_motion.cli.sources import CALIBRATION, MACHINE, MachineSource, chosen_among
from so101_motion.common.errors import CalibrationError, MachineRefused, PortUnavailable, So101Error
from so101_motion.common.units import to_deg

if TYPE_CHECKING:
    from so101_motion.calib.record.store import Stored
    from so101_motion.rig.rig import Rig
    from so101_motion.setup.checkup import Check, Findings
    from so101_motion.setup.discovery import PortReport

_FAILURES = 2  # most failure records in a report: the newest, and one to compare it with. Chosen

_SIGNS = {"ok": ("✓", "green"), "warn": ("!", "yellow"), "fail": ("✗", "red")}


@verb()
def doctor(
    sim: bool = flag("The simulated arm: checks the installation only."),
    port: str | None = port_option("Serial port of the arm; by default the only one with an arm"),
    calibration: Path | None = CALIBRATION,
    report: Path | None = option("Write the report to this file as well.", OutFile()),
    machine: MachineSource | None = MACHINE,
    as_json: bool = JSON,
) -> None:
    """Check the installation, the port, the servos and the calibration; nothing moves.

    Each check prints its result, and what to do if something is wrong. The exit code is 0 if the
    arm can be moved, also with warnings, and 6 if it cannot.

    \b
    so101 doctor
    so101 doctor --port /dev/ttyACM0 --report doctor.md
    so101 doctor --machine my-arm.local:8080
    """  # noqa: D301
    from so101_motion.setup.checkup import TORQUE, check_up, is_healthy

    chosen = chosen_among({"--sim": sim or None, "--port": port, "--machine": machine})
    if calibration is not None and chosen in ("--sim", "--machine"):
        raise click.UsageError("--calibration belongs to --port")
    if chosen == "--machine" and machine is not None:
        if report is not None:
            raise click.UsageError("--report needs a port; leave it out with --machine")
        _diagnose_machine(machine, as_json)
        return

    if sim:
        with quietly(), busy_message("examining"):
            seen = _installed(is_whole=True)
    else:
        seen = examined(port, calibration)
    checks = check_up(seen)
    if as_json:
        print_json("doctor", _facts(seen, checks))
    else:
        for check in checks:
            _print(check)
    if report is not None:
        _write(report, seen, checks)
    if not sim and not as_json:
        _print_next(seen, checks)
    if not is_healthy(checks):
        aside("not ready to move")
        raise SystemExit(CHECK_FAILED)
    if not as_json and all(check.name != TORQUE for check in checks):
        aside("ready to move")


def _diagnose_machine(machine: MachineSource, as_json: bool) -> None:
    with quietly(), closing(machine.open()) as rig:
        try:
            answer = dict(rig.do_command(rig.arm_name, {"command": "diagnose"}))
        except MachineRefused as refusal:
            if refusal.status != "INVALID_ARGUMENT":
                raise
            answer = {}  # a simulated arm, or another module's, without this command
        healthy = bool(answer.get("success", True))
        told = answer.get("findings") or ([] if healthy else [answer.get("error")])
        findings = [str(each) for each in told if each]
    if as_json:
        print_json("doctor", {"source": machine.what, "healthy": healthy, "told": answer})
    else:
        for finding in findings:
            echo(finding)
    if not healthy:
        raise SystemExit(CHECK_FAILED)
    if not as_json:
        found = (
            "finds no problem with its servos" if answer else "answers, and has no servos to check"
        )
        aside(f"the {machine.what} {found}")


# Checks


def _installed(*, is_whole: bool) -> Findings:
    """Check the installation; ``is_whole`` if no arm is checked after it."""
    from so101_motion.rig.simulated_rig import open_simulated
    from so101_motion.setup.checkup import Findings, software

    with open_simulated() as rig:
        seen = _planned(Findings(software=software()), rig)
        if is_whole:
            seen = replace(seen, speed=rig.arm.speed, acceleration=rig.arm.acceleration)
        return seen


def examined(port: str | None, calibration: Path | None) -> Findings:
    """Check installation, port, servos and calibration, as the verb does; nothing moves."""
    with quietly(), busy_message("examining"):
        return _with_port(_installed(is_whole=False), port, calibration)


def _with_port(seen: Findings, port: str | None, calibration: Path | None) -> Findings:
    from so101_motion.calib.record import store
    from so101_motion.drivers.port.port_list import adapters_without_port

    try:
        report = port_choice.find_to_examine(port)
    except PortUnavailable as error:
        lost = adapters_without_port()
        return replace(seen, port=port, port_trouble=error.reason, lost_adapters=lost)
    file = report.calibration if calibration is None else store.resolve(str(calibration))
    return replace(
        examined_arm(report, file),
        software=seen.software,
        planning_time=seen.planning_time,
        planning_trouble=seen.planning_trouble,
    )


def examined_arm(report: PortReport, file: Path | None = None) -> Findings:
    """Check one arm against ``file``, by default the calibration that agrees with its servos."""
    from so101_motion.setup.connect import about

    return _with_arm(_with_file(about(report), file or report.calibration), report)


def _with_file(seen: Findings, file: Path | None) -> Findings:
    from so101_motion.calib.procedure import journal
    from so101_motion.calib.record import store
    from so101_motion.setup.identify import changes_since

    if file is None:
        return seen
    seen = replace(
        seen,
        file=file,
        is_unfinished=journal.path_for(file).exists(),
        servo_changes=changes_since(file),
    )
    try:
        return replace(seen, stored=store.read(file))
    except CalibrationError as error:
        return replace(seen, file_trouble=str(error))


def _with_arm(seen: Findings, report: PortReport) -> Findings:
    from so101_motion.setup.checkup import examine

    try:
        with port_choice.lent_bus(report, "a check-up") as (rig, lease):
            servos, bus_quality = examine(lease)
            seen = replace(
                seen,
                servos=servos,
                bus_quality=bus_quality,
                speed=rig.arm.speed,
                acceleration=rig.arm.acceleration,
            )
    except PortUnavailable as error:
        return replace(seen, port_trouble=error.reason)
    from so101_motion.calib.record.zero_report import explain_stored

    return replace(seen, zero_reports=explain_stored(seen.stored or _as_servos_hold(seen)))


def _as_servos_hold(seen: Findings) -> Stored:
    """The calibration in the servos' registers, used when there is no file."""
    from so101_motion.calib.record import record
    from so101_motion.calib.record.store import Stored

    calibration = {
        joint: record.from_registers(joint, facts.servo_id, facts.calibration)[0]
        for joint, facts in seen.facts.items()
        if facts.is_calibrated
    }
    return Stored(path=Path(), calibration=calibration, zeros={}, notes=())


def _planned(seen: Findings, rig: Rig) -> Findings:
    """Add the time that a plan takes, after a first one."""
    import numpy as np

    from so101_motion.planning.goals import PoseGoal

    goal = PoseGoal.at_point(np.array([0.25, 0.12, 0.15]))
    try:
        rig.arm.plan(goal)
        begin = time.perf_counter()
        rig.arm.plan(goal)
        return replace(seen, planning_time=time.perf_counter() - begin)
    except So101Error as error:
        return replace(seen, planning_trouble=str(error))


# Output


def _print(check: Check) -> None:
    sign, colour = _SIGNS[check.verdict]
    click.echo(click.style(sign, fg=colour) + f" {check.name}")
    echo(check.sentence, indent="    ")
    if check.fix:
        echo(f"try: {check.fix}", indent="    ")


def _print_next(seen: Findings, checks: tuple[Check, ...]) -> None:
    from so101_motion.setup.setup_steps import FULL, SetupState

    wrong = [each for verdict in ("fail", "warn") for each in checks if each.verdict == verdict]
    if wrong:
        aside(f"next: {wrong[0].fix} ({wrong[0].name})")
        return
    left = FULL.next_open(SetupState.found(seen))
    if left is not None:
        aside(f"next step of the setup: {left.title} (so101 setup --web)")


def _facts(seen: Findings, checks: tuple[Check, ...]) -> dict[str, Any]:
    from so101_motion.setup.checkup import is_healthy

    heard, file = seen.bus_quality, seen.file
    return {
        "healthy": is_healthy(checks),
        "checks": [asdict(check) for check in checks],
        "software": dict(seen.software),
        "port": seen.port,
        "calibration_file": None if file is None else str(file),
        "servos": {
            joint: {"id": facts.servo_id, **facts.held} for joint, facts in seen.facts.items()
        },
        "bus": None if heard is None else {
            "asked": heard.asked, "late": heard.late, "lost": heard.lost, "garbled": heard.corrupt,
            "lateness_ms": round(1e3 * heard.lateness, 3),
            "cycle_ms": {
                name: round(1e3 * getattr(heard, name), 3) for name in ("median", "p99", "longest")
            },
        },
        "zeros": [
            {"joint": m.joint, "by": m.by, "middle_deg": m.angle_deg, "jaws_mm": m.jaws_mm}
            for m in seen.zero_reports
        ],
        "planned": {
            "speed_degs_per_sec": _deg(seen.speed),
            "acceleration_degs_per_sec_per_sec": _deg(seen.acceleration),
        },
    }  # fmt: skip


def _write(path: Path, seen: Findings, checks: tuple[Check, ...]) -> None:
    lines = [f"# so101 doctor, version {__version__}", "", "| | what | found | try |", "|-|-|-|-|"]
    lines += [
        f"| {_SIGNS[c.verdict][0]} | {c.name} | {_cell(c.sentence)} | {_cell(c.fix)} |"
        for c in checks
    ]
    facts = json.dumps(_facts(seen, checks), indent=2)
    lines += ["", "All values:", "", "```json", facts, "```", ""]
    lines += _failures()
    write_report(path, "\n".join(lines).encode())


def _failures() -> list[str]:
    from so101_motion.files.failure_record import newest

    lines: list[str] = []
    for path in newest()[:_FAILURES]:
        try:
            lines += [f"The second before a failure, {path}:", "", "```json"]
            lines += [path.read_text(encoding="utf-8").rstrip(), "```", ""]
        except OSError:  # an older one, just removed
            lines += ["gone", "```", ""]
    return lines


def _deg(value: float | None) -> float | None:
    return None if value is None else to_deg(value)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
