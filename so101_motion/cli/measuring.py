"""Verbs that move every joint to measure the arm: move-test, identify and report-arm."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from so101_motion import __version__
from so101_motion.cli.options import JSON, YES, argument, flag, verb
from so101_motion.cli.param_types import OutFile
from so101_motion.cli.shared import (
    CHECK_FAILED,
    INTERRUPTED,
    answer,
    aside,
    have_agreed,
    print_json,
    quietly,
    run_beside,
    write_report,
)
from so101_motion.cli.sources import SOURCE, Source

if TYPE_CHECKING:
    from so101_motion.rig.hardware_rig import HardwareRig


@verb()
def move_test(
    source: Source = SOURCE,
    yes: bool = YES,
    as_json: bool = JSON,
) -> None:
    """Move every joint a little and check that it follows commands. The arm MOVES.

    One joint after the other moves six degrees back and forth, slowly, clear of all known
    obstacles, and stands still to be measured; then the jaw opens and closes a little. Ctrl-C stops
    the arm. Exit code 6 if a joint does not follow.

    \b
    so101 move-test --port /dev/ttyACM0 --json > test.json
    so101 move-test --sim --yes
    """  # noqa: D301
    from so101_motion.cli.operation_terminal import printed
    from so101_motion.setup.move_test import MoveTest

    stopped = threading.Event()
    with quietly(), source.open() as rig:
        test = MoveTest(rig, name=source.what)
        outline = test.outline()
        for reason in dict.fromkeys(reason for _, reason in outline.obstacles):
            joints = ", ".join(joint for joint, each in outline.obstacles if each == reason)
            aside(f"cannot be tested here: {joints}: {reason}")
        aside(outline.sentence)
        have_agreed(f"Is everything out of the way? Move the {source.what}?", yes)

        def stop() -> None:
            stopped.set()
            test.cancel()

        def show(joint: str, share: float) -> None:
            aside(f"{100.0 * share:3.0f} %  {joint}")

        found = run_beside(partial(test.move_and_measure, outline, show), stop)
        text = printed(test.view, f"{found.sentence}.", f"{found.arm}, {found.seconds:.0f} s")
    answer(as_json, "move-test", found.to_json(), text)
    if stopped.is_set():
        raise SystemExit(INTERRUPTED)
    if not found.passed:
        raise SystemExit(CHECK_FAILED)


@verb()
def identify(
    source: Source = SOURCE,
    carrying: bool = flag("The hand holds something: measure its weight as well."),
    check: bool = flag("Save nothing; only tell how well the figures predict."),
    undo: bool = flag("Move nothing: restore the previous figures."),
    yes: bool = YES,
    as_json: bool = JSON,
) -> None:
    """Measure how this arm's servos differ from their type. The arm MOVES.

    The arm is raised, and one joint after the other moves back and forth through a wide part of its
    range, clear of all known obstacles, for nearly three minutes. The hand must be empty;
    otherwise give --carrying. The result is saved beside the calibration, and used from the next
    start on. Ctrl-C stops the arm.

    \b
    so101 identify --port /dev/ttyACM0
    so101 identify --port /dev/ttyACM0 --carrying
    so101 identify --port /dev/ttyACM0 --check
    so101 identify --port /dev/ttyACM0 --undo
    """  # noqa: D301
    from so101_motion.cli.operation_terminal import printed
    from so101_motion.rig.hardware_rig import HardwareRig
    from so101_motion.setup.identify_operation import IdentifyOperation

    if undo:
        _restore_figures(source, as_json)
        return
    with quietly(), source.open() as rig:
        if not isinstance(rig, HardwareRig):
            raise click.UsageError("the simulated arm has no servos to identify; give --port")
        operation = IdentifyOperation(rig, on_progress=aside)
        planned = operation.ask("plan")
        for joint, reason in planned["cannot_move"].items():
            aside(f"{joint} cannot be identified here: {reason}")
        aside(planned["will_move"])
        have_agreed(f"Is everything out of the way? Move the {source.what}?", yes)
        move = partial(operation.ask, "move", carrying=carrying, check=check)
        run_beside(move, operation.close)
        report = operation.report
        assert report is not None
        text = printed(operation.view, *report.remarks(), operation.view.text)
    answer(as_json, "identify", report.to_json(), text)


def _restore_figures(source: Source, as_json: bool) -> None:
    from so101_motion.calib.record import servo_file
    from so101_motion.common.errors import CalibrationError

    calibration = source.known_calibration()
    if calibration is None:
        raise CalibrationError(None, f"the {source.what} has no calibration", "calibrate it first")
    kept = servo_file.restore(calibration)
    file = servo_file.servos_path(calibration)
    if as_json:
        print_json("identify", {"file": str(file), "at": kept.at, "joints": list(kept.servos)})
    else:
        aside(f"{file} has the figures of {kept.at} again; they are used from the next start")


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
    records them: five minutes. The hand must be empty. Ctrl-C stops the arm.

    FILE is text. It has no serial numbers, no names of ports or folders. Read it before you send
    it; the program itself sends nothing.

    \b
    so101 report-arm my-arm.json --port /dev/ttyACM0
    """  # noqa: D301
    from so101_motion.cli.calibration import verified
    from so101_motion.cli.doctor import examined
    from so101_motion.rig.hardware_rig import HardwareRig
    from so101_motion.setup.checkup import check_up, is_healthy
    from so101_motion.setup.identify import REPORT_REST, REPORT_SPEEDS, Identification

    if source.port is None:
        raise click.UsageError("the simulated arm has no servos to report of; give --port")
    checks = check_up(examined(source.port, source.calibration_file))
    for each in checks:
        aside(f"{each.verdict:5}{each.name}: {each.sentence}")
    if not is_healthy(checks):
        aside("mend that first (so101 doctor); nothing moved and nothing was written")
        raise SystemExit(CHECK_FAILED)
    given = str(source.calibration_file) if source.calibration_file else None
    rows = verified(given, source.port, yes)[1] if verify else ()
    with quietly(), source.open() as rig:
        assert isinstance(rig, HardwareRig)
        rig.arm.set_speed(max(rig.arm.speed, REPORT_SPEEDS[-1]))
        motions = Identification(rig, speeds=REPORT_SPEEDS, rest=REPORT_REST)
        outline = motions.outline()
        for joint, reason in outline.obstacles:
            aside(f"{joint} cannot be moved here: {reason}")
        aside(outline.sentence)
        have_agreed(
            f"Is everything out of the way, and the hand empty? Move the {source.what}?", yes
        )
        move = partial(motions.move_and_record, outline, lambda joint, _: aside(joint))
        run_beside(move, motions.cancel)
        recorded, registers = motions.recorded(), registers_of(rig)
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


def registers_of(rig: HardwareRig) -> dict[str, dict[str, int]]:
    """What the servos hold while the arm is driven, by joint and register."""
    from so101_motion.drivers.feetech.servo_settings import read_registers

    lease = rig.lend_bus("reading the servos' registers")
    try:
        return {
            joint: lease.call(partial(read_registers, servo_id=setup.map.servo_id))
            for joint, setup in rig.servos.setups.items()
        }
    finally:
        lease.give_back(hold=True)


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
