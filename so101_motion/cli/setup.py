"""``so101 setup``: each motor of a kit gets its id, one at a time, guided."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import click

from so101_motion.cli.shared import (
    CHECK_FAILED,
    INTERRUPTED,
    STOPPED,
    json_option,
    print_json,
    reports_errors,
)
from so101_motion.state import ARM_JOINTS, GRIPPER_JOINT

if TYPE_CHECKING:
    from so101_motion.calib.setup_view import SetupView, Verification
    from so101_motion.calibrator import Calibrator
    from so101_motion.cli.motor_walk import MotorWalk, Progress
    from so101_motion.cli.terminal import Terminal


@click.command()
@click.option(
    "--port",
    envvar="SO101_PORT",
    metavar="PORT",
    help="Serial port, such as /dev/ttyACM0 (or SO101_PORT); by default the only servo adapter.",
)
@click.option(
    "--joint",
    "joints",
    type=click.Choice([*ARM_JOINTS, GRIPPER_JOINT]),
    multiple=True,
    help="Only this joint's motor; repeatable.",
)
@click.option(
    "--start-over", is_flag=True, help="Begin with the gripper, whatever was done before."
)
@click.option("--yes", is_flag=True, help="Ask nothing: for scripts.")
@click.option("--within", type=float, metavar="S", help="Give up a step after so many seconds.")
@click.option("--events", type=click.File("w"), help="What is said, as JSON lines, into a file.")
@json_option
@reports_errors
def setup(
    port: str | None,
    joints: tuple[str, ...],
    start_over: bool,
    yes: bool,
    within: float | None,
    events: TextIO | None,
    as_json: bool,
) -> None:
    """Give the motors of a new kit their ids, one at a time.

    New motors all have the id 1, so on one cable they cannot be told apart. Connect each alone when
    you are asked for it; the rest happens by itself. At the end, with all six on the cable,
    everything is verified. You may stop at any time: the next start goes on where this one ended.

    \b
    so101 setup                        with the only servo adapter that is plugged in
    so101 setup --joint wrist_flex     after that motor was replaced
    so101 setup --port /tmp/so101      beside "so101 emulate --new --link /tmp/so101"
    """  # noqa: D301
    from so101_motion.cli import finding
    from so101_motion.cli.motor_walk import MotorWalk, Progress
    from so101_motion.cli.shared import quietly
    from so101_motion.cli.terminal import Quit, Terminal

    report = finding.find_adapter(port)
    name = report.port.name
    progress = Progress(finding.own_folder() / "setup.json", name)
    with quietly(), closing(_opened(name, finding.calibration_file(None, report))) as calibrator:
        motors = calibrator.motor_setup
        with Terminal(ask=not yes, events=events) as terminal:
            terminal.say(f"motors on {name}", port=name)
            walk = MotorWalk(motors, terminal, progress, within=within)
            try:
                checked = None
                if joints:
                    _some(walk, joints)
                elif len(report.joints) == 6 and not start_over:
                    terminal.say("all six motors answer already")
                    checked = motors.verify()
                else:
                    checked = _all(walk, terminal, progress, start_over)
            except (Quit, KeyboardInterrupt) as reason:
                terminal.say("stopped; so101 setup goes on from here", style="yellow")
                raise SystemExit(STOPPED if isinstance(reason, Quit) else INTERRUPTED) from None
        _conclude(name, motors.view, checked, as_json)


def _opened(port: str, file: Path) -> Calibrator:
    """The port, with nothing driven. Motors are given its rate, which is that of new ones."""
    from so101_motion.calibrator import Calibrator
    from so101_motion.rig import open_hardware
    from so101_motion.servos import ServoSettings

    return Calibrator(open_hardware(ServoSettings(port=port, timeout=None, fallback_file=file)))


def _some(walk: MotorWalk, joints: tuple[str, ...]) -> None:
    for joint in joints:
        walk.set_up(joint)


def _all(walk: MotorWalk, terminal: Terminal, progress: Progress, start_over: bool) -> Verification:
    from so101_motion.cli.motor_walk import remaining

    if start_over:
        progress.clear()
    elif progress.done:
        terminal.say(
            f"set up before: {', '.join(progress.done)}; going on from there"
            " (--start-over begins with the gripper)"
        )
    for joint in remaining(progress.done):
        walk.set_up(joint)
    checked = walk.verify()
    if checked.ok:
        progress.clear()
    return checked


def _conclude(port: str, view: SetupView, checked: Verification | None, as_json: bool) -> None:
    sentence = view.status if checked is None else checked.sentence
    if as_json:
        print_json("setup", {"port": port, "sentence": sentence, **_facts(view, checked)})
    else:
        click.echo(sentence)
    for note in checked.notes if checked is not None else ():
        click.echo(f"note: {note}", err=True)
    if checked is None:
        click.echo("next: so101 doctor, once the whole arm is on the cable", err=True)
        return
    if checked.ok:
        click.echo("next: put the arm together, then so101 calibrate", err=True)
        return
    for check in checked.motors.values():
        if check.error:
            click.echo(f"error: {check.error}\n  try: {check.fix}", err=True)
    raise SystemExit(CHECK_FAILED)


def _facts(view: SetupView, checked: Verification | None) -> dict[str, object]:
    motors = []
    for joint, motor in view.motors.items():
        check = checked.motors[joint] if checked is not None else None
        motors.append(
            {
                "joint": joint,
                "servo_id": motor.target_id,
                "state": motor.state,
                "model": motor.model,
                "firmware": motor.firmware,
                "volts": motor.volts,
                "status": None if check is None else check.status,
                "error": "" if check is None else check.error,
                "fix": "" if check is None else check.fix,
            }
        )
    return {"ok": None if checked is None else checked.ok, "motors": motors}
