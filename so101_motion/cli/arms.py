"""``so101 arms``: all arms of this computer in one table, which is which, and a file for them."""

from __future__ import annotations

from contextlib import closing
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import click

from so101_motion.cli.options import JSON, flag, option, verb
from so101_motion.cli.param_types import Finite, OutFile
from so101_motion.cli.ports import FURTHER_PORTS
from so101_motion.cli.shared import (
    CHECK_FAILED,
    NO_DEVICE,
    agrees,
    aside,
    busy_message,
    print_json,
    quietly,
    stops_on_ctrl_c,
)
from so101_motion.cli.sources import Source
from so101_motion.common.attributes import SPEED_RANGE_DEG
from so101_motion.common.errors import So101Error, in_series
from so101_motion.common.units import to_rad

if TYPE_CHECKING:
    from so101_motion.setup.checkup import Check
    from so101_motion.setup.discovery import PortReport

_NUDGE = 0.03  # share of the jaw's travel: 3 deg. The jaw, because no pose of the arm is in its way
_APART = 2.0  # between the bases in a cell file [m]: nothing meets; chosen


@verb()
def arms(
    extra: tuple[str, ...] = FURTHER_PORTS,
    nudge: bool = flag("Move each jaw by 3 deg and back, to tell which is which; asks first."),
    cell: Path | None = option(
        "Add them to this cell file, or make it: so101 view --cell shows all on one page.",
        OutFile(".json"),
    ),
    max_speed: float | None = option(
        "With --cell: no page or program moves an arm faster that is added.",
        Finite(*SPEED_RANGE_DEG), metavar="DEG/S",
    ),
    as_json: bool = JSON,
) -> None:  # fmt: skip
    """List all arms of this computer: port, calibration and health.

    \b
    so101 arms
    so101 arms --nudge
    so101 arms --cell class.json --max-speed 30    then: so101 view --cell class.json
    so101 cell run class.json wave.json --all      every arm runs the same program

    A cell file that is there keeps all it says; it gets the arms on ports that it does not name.
    """  # noqa: D301
    from rich.console import Console
    from rich.table import Table

    from so101_motion.common.geometry import SE3
    from so101_motion.drivers.port.port_list import device_of
    from so101_motion.files.cell_file import CellArm, add_arms, read_cell
    from so101_motion.setup.discovery import discover

    if max_speed is not None and cell is None:
        raise click.UsageError("--max-speed belongs to --cell")
    known = read_cell(cell).arms if cell is not None and cell.exists() else ()
    with quietly(), busy_message("searching the serial ports"):
        reports = discover(extra).reports
        found = [report for report in reports if report.has_arm]
        others = [
            each for each in reports
            if not each.has_arm and (each.port.is_servo_adapter or each.port.name in extra)
        ]  # fmt: skip
        wrong = [_wrong(report) for report in found]
    if as_json:
        rows = [
            {
                **report.to_json(),
                "wrong": [f"{_can(c)}; {c.name}: {c.sentence}; {c.fix}" for c in each],
            }
            for report, each in zip(found, wrong, strict=True)
        ]
        print_json("arms", {"arms": rows})
    elif found or others:
        table = Table("port", "arm", "calibration", "health", box=None, pad_edge=False)
        for report, each in zip(found, wrong, strict=True):
            kind = f"{report.role}, {report.nominal_volts or 0:g} V"
            file = report.calibration.name if report.calibration else "none"
            health = f"{_can(each[0])}; see {', '.join(c.name for c in each)}" if each else "ready"
            table.add_row(report.port.name, kind, file, health)
        for other in others:  # in use, without power or without a whole arm
            table.add_row(other.port.name, "none", "", other.sentence)
        Console().print(table)
        if any(wrong):
            aside("so101 doctor --port PORT says what an arm lacks and what to do about it")
    if not found:
        aside("no arm answers" + ("" if others else "; so101 ports tells why"))
        raise SystemExit(NO_DEVICE)
    there = {device_of(each.port) for each in known if each.port}
    new = [report for report in found if device_of(report.port.name) not in there]
    taken, added = {each.name for each in known}, list[CellArm]()

    def its_own(given: str) -> str:
        if given in taken:
            raise click.UsageError(f'another arm is called "{given}"')
        return given

    y = max((float(each.T_cell_base.p[1]) + _APART for each in known), default=0.0)
    for report in new:
        name = next(name for k in count(1) if (name := f"arm {k}") not in taken)
        if nudge:
            try:
                asked = _nudged(report)
                if cell is not None:
                    name = click.prompt(asked, default=name, err=True, value_proc=its_own)
            except So101Error as error:
                aside(f"{report.port.name} is left out: {error}")
                continue
        taken.add(name)
        added.append(
            CellArm(
                name=name,
                T_cell_base=SE3.from_translation((0.0, y + _APART * len(added), 0.0)),
                port=report.port.name,
                calibration_id="" if report.calibration is None else str(report.calibration),
                max_speed=None if max_speed is None else to_rad(max_speed),
            )
        )
    if cell is not None and (added or known):
        if added:
            add_arms(added, cell)
        many = f"{len(added)} of {len(new)} arm{'' if len(new) == 1 else 's'}"
        say = f"{many if new else 'no new arm'} written to {cell}"
        if known:
            say += f"; what it says of {in_series(each.name for each in known)} stays"
        aside(f"{say}; next: so101 view --cell {cell}")
    if len(added) < len(new):
        raise SystemExit(CHECK_FAILED)


def _wrong(report: PortReport) -> list[Check]:
    """What the doctor finds to be wrong with an arm, the worst first."""
    from so101_motion.cli.doctor import examined_arm
    from so101_motion.setup.checkup import check_up

    checks = check_up(examined_arm(report))
    return [each for verdict in ("fail", "warn") for each in checks if each.verdict == verdict]


def _can(check: Check) -> str:
    return "cannot move" if check.verdict == "fail" else "can move"


def _nudged(report: PortReport) -> str:
    """Nudge an arm if a person agrees; returns how to ask for its name."""
    port = report.port.name
    if not agrees(f"Move the jaw of the arm on {port} by 3 deg and back?", otherwise=""):
        return f"What is the arm on {port} called?"
    _nudge(Source(port=port, calibration_file=report.calibration, say=lambda _: None))
    return "What is the arm that moved called?"


def _nudge(source: Source) -> None:
    """Move the jaw a little and back; a limp arm is limp again afterwards."""
    from so101_motion.cli.status import is_held
    from so101_motion.rig.hardware_rig import HardwareRig

    with quietly(), closing(source.open_to_look()) as rig:
        was_held = isinstance(rig, HardwareRig) and is_held(rig)
    with quietly(), closing(source.open()) as rig, stops_on_ctrl_c(rig.gripper):
        at = rig.gripper.aperture
        rig.gripper.move(at + (_NUDGE if at < 0.5 else -_NUDGE))
        rig.gripper.move(min(max(at, 0.0), 1.0))
        if not was_held:
            rig.arm.set_torque(False)
