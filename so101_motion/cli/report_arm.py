"""``so101 report-arm``: examine an arm, move it, and write one file that tells how it behaves."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from so101_motion import __version__
from so101_motion.cli.options import YES, argument, flag, verb
from so101_motion.cli.param_types import OutFile
from so101_motion.cli.shared import (
    CHECK_FAILED,
    have_agreed,
    quietly,
    run_beside,
    write_report,
)
from so101_motion.cli.sources import SOURCE, Source

_KEPT = (
    "firmware_major", "firmware_minor", "p_gain", "d_gain", "i_gain", "startup_force",
    "cw_dead_zone", "ccw_dead_zone", "max_voltage", "acceleration", "goal_velocity",
    "torque_limit", "present_voltage", "present_temperature", "max_acceleration",
)  # fmt: skip
"""Registers in the file: what bears on how a servo moves, and nothing that tells which it is."""


@verb()
def report_arm(
    file: Path = argument(OutFile(".json")),
    source: Source = SOURCE,
    verify: bool = flag("Lead the limp joints to their stops first."),
    yes: bool = YES,
) -> None:
    """Write FILE: how this arm is and how it moves. The arm MOVES.

    It examines the arm as doctor does, checks the calibration by hand with --verify, then moves one
    joint after the other through standard motions, at 15, 45 and at most 90 deg/s, with rests, and
    records them: four minutes. The hand must be empty. Ctrl-C stops the arm.

    FILE is text. It has no serial numbers, no names of ports or folders. Read it before you send
    it; the program itself sends nothing.

    \b
    so101 report-arm my-arm.json --port /dev/ttyACM0
    """  # noqa: D301
    from so101_motion.cli.calibration import verified
    from so101_motion.cli.doctor import examined
    from so101_motion.rig.hardware_rig import HardwareRig
    from so101_motion.setup.checkup import check_up, is_healthy
    from so101_motion.setup.standard_motions import SPEEDS, StandardMotions

    if source.port is None:
        raise click.UsageError("the simulated arm has no servos to report of; give --port")
    checks = check_up(examined(source.port, source.calibration_file))
    for each in checks:
        click.echo(f"{each.verdict:5}{each.name}: {each.sentence}", err=True)
    if not is_healthy(checks):
        click.echo(
            "mend that first (so101 doctor); nothing moved and nothing was written", err=True
        )
        raise SystemExit(CHECK_FAILED)
    given = str(source.calibration_file) if source.calibration_file else None
    rows = verified(given, source.port, yes)[1] if verify else ()
    with quietly(), source.open() as rig:
        assert isinstance(rig, HardwareRig)
        rig.arm.set_speed(max(rig.arm.speed, SPEEDS[-1]))
        motions = StandardMotions(rig)
        outline = motions.outline()
        for joint, reason in outline.obstacles:
            click.echo(f"{joint} cannot be moved here: {reason}", err=True)
        click.echo(motions.sentence(outline), err=True)
        if not yes:
            have_agreed(
                f"Is everything out of the way, and the hand empty? Move the {source.what}?"
            )

        def move() -> Mapping[str, Any]:
            return motions.move_and_record(outline, lambda j: click.echo(j or "done", err=True))

        recorded = run_beside(move, motions.cancel)
        registers = motions.registers()
    found = {
        "what": "so101 report-arm",
        "version": __version__,
        "checks": [
            {"name": c.name, "verdict": c.verdict, "sentence": nameless(c.sentence)}
            for c in checks
            if c.name not in ("port", "adapter", "software")
        ],
        "calibration": {row.joint: row.sentence for row in rows},
        "servos": {j: {k: held[k] for k in _KEPT if k in held} for j, held in registers.items()},
    }
    write_report(file, text(found, recorded).encode())
    click.echo(f"{len(recorded)} motions; read the file before you send it to anybody")


def nameless(sentence: str) -> str:
    """The sentence without paths: they tell ports, users and adapters' serial numbers."""
    return re.sub(r"(?<!\w)(?:[A-Za-z]:)?[\\/][^\s,;:()]+", "(path)", sentence)


def text(found: Mapping[str, Any], motions: Mapping[str, Any]) -> str:
    """JSON with a line for each moment of a motion."""
    parts = [json.dumps(found, indent=1, ensure_ascii=False)[:-2], ',\n "motions": {']
    for k, (name, arrays) in enumerate(motions.items()):
        parts.append(("," if k else "") + f"\n  {json.dumps(name)}: {{")
        for i, (key, rows) in enumerate(arrays.items()):
            lines = ",\n".join(f"    {json.dumps(row)}" for row in rows)
            parts.append(("," if i else "") + f"\n   {json.dumps(key)}: [\n{lines}]")
        parts.append("}")
    return "".join([*parts, "}\n}\n"])
