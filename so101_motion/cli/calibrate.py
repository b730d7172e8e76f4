"""``so101 calibrate``: calibrate an arm step by step."""

from __future__ import annotations

from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, TextIO

import click

from so101_motion.cli import port_choice
from so101_motion.cli.calibration import facts
from so101_motion.cli.completion import completed_files
from so101_motion.cli.options import EVENTS, JSON, flag, option, verb
from so101_motion.cli.param_types import port_option
from so101_motion.cli.shared import STOPPED, aside, echo, print_json, quietly
from so101_motion.cli.sources import MACHINE, MachineSource, chosen_among
from so101_motion.common import interrupts
from so101_motion.common.errors import So101Error
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT

if TYPE_CHECKING:
    from so101_motion.cli.operation_terminal import OperationTerminal
    from so101_motion.cli.terminal import Terminal
    from so101_motion.common.operation import View
    from so101_motion.setup.calibrator import StepResult

_JOINT = click.Choice([*ARM_JOINTS, GRIPPER_JOINT])


@verb()
def calibrate(
    port: str | None = port_option("Serial port of the arm; by default the only one with an arm"),
    file: str | None = option(
        "Where to save; by default the file this arm already has.", shell_complete=completed_files
    ),
    joints: tuple[str, ...] = option(
        "Only this one; repeatable.", _JOINT, name="--joint", multiple=True
    ),
    yes: bool = flag("Ask no questions; for scripts."),
    events: TextIO | None = EVENTS,
    machine: MachineSource | None = MACHINE,
    as_json: bool = JSON,
) -> None:
    """Calibrate the arm: find the ends of each joint's travel, so that its angles are right.

    The joints go limp, and you move each by hand to both its stops; bars show the progress. It
    takes two minutes. Until you save, Ctrl-C restores the previous settings. After saving, the arm
    holds its position.

    \b
    so101 calibrate                      the only arm that is plugged in
    so101 calibrate --file my_arm.json   save to this file
    so101 calibrate --joint gripper      only the jaw; the other joints keep theirs
    so101 calibrate --machine kit.local:8080   through a machine's calibration sensor
    """  # noqa: D301
    if machine is not None and chosen_among({"--port": port, "--machine": machine}) != "--port":
        if file or joints or yes or as_json:
            raise click.UsageError("--machine goes with --events only; its sensor has the file")
        _on_machine(machine, events)
        return
    from so101_motion.calib.record.record import JOINTS
    from so101_motion.calib.record.zero_report import explain_stored
    from so101_motion.cli.operation_terminal import OperationTerminal
    from so101_motion.cli.terminal import Terminal
    from so101_motion.rig.joint_setup import Doubt
    from so101_motion.setup.calibration_operation import CalibrationOperation
    from so101_motion.setup.calibrator import Calibrator

    report = port_choice.find_arm(port)
    path = port_choice.calibration_file(file, report)
    with (
        quietly(),
        closing(
            Calibrator.open(report.port.name, path, joints or JOINTS, baudrate=report.baudrate)
        ) as calibrator,
    ):
        with Terminal(ask=not yes, events=events) as terminal:
            terminal.say(f"arm on {report.port.name}; the calibration will be saved to {path}")
            for note in calibrator.situation.notes:
                if not isinstance(note, Doubt):
                    terminal.say(f"note: {note}")
            operation = CalibrationOperation(
                calibrator, by_itself=True, is_attended=terminal.is_manned
            )
            _go_through(OperationTerminal(operation, terminal), terminal)
        ended = operation.ended
        assert ended is not None
        assert ended.stored is not None
        if as_json:
            meaning = [each.sentence for each in explain_stored(ended.stored)]
            held = {"holds": ended.holds, "trouble": ended.trouble, "meaning": meaning}
            print_json("calibrate", {"port": report.port.name, **facts(ended.stored), **held})
        else:
            _print_result(operation.view, ended)


def _on_machine(source: MachineSource, events: TextIO | None) -> None:
    from so101_motion.cli.operation_terminal import OperationTerminal
    from so101_motion.cli.terminal import Terminal
    from so101_motion.common.operation import RemoteOperation

    with quietly(), source.connect() as machine:
        send = partial(machine.do_command, machine.calibration_sensor())
        with (
            closing(RemoteOperation(send, "calibration")) as operation,
            Terminal(events=events) as terminal,
        ):
            if not terminal.is_manned:
                raise click.UsageError("--machine needs a terminal: a person moves the joints")
            _go_through(OperationTerminal(operation, terminal), terminal)
            view = operation.view
        _print_view(view)


def _print_view(view: View) -> None:
    click.echo(view.text)
    if view.note:
        aside(view.note)


def _go_through(walk: OperationTerminal, terminal: Terminal) -> None:
    from so101_motion.cli.terminal import Quit

    try:
        walk.go()
    except KeyboardInterrupt:
        raise interrupts.ToldInterrupt(_put_back(walk)) from None
    except (Quit, So101Error) as reason:
        terminal.say(f"cancelled: {_put_back(walk)}", style="yellow")
        if isinstance(reason, So101Error):
            raise
        raise SystemExit(STOPPED) from None


def _put_back(walk: OperationTerminal) -> str:
    """Undo the calibration; returns how that has left the arm."""
    try:
        return walk.give_up()
    except So101Error as error:
        later = "when the arm is next opened with this calibration file, or calibrated"
        return (
            f"the servos' previous settings could not be restored ({error}); this is done {later}"
        )


def _print_result(view: View, ended: StepResult) -> None:
    _print_view(view)
    if ended.holds:
        held = "the other joints are held" if ended.trouble else "the arm is held where it stands"
        echo(f"{held}; switch its power off to release it", err=True)
    echo("next: so101 doctor, then so101 jog, or so101 viam config for Viam", err=True)
