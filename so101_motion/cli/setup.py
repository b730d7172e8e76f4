"""``so101 setup``: set up the motors of a kit one by one; with ``--web``, the whole setup."""

from __future__ import annotations

from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, TextIO

import click

from so101_motion.cli import port_choice
from so101_motion.cli.options import EVENTS, JSON, flag, option, verb
from so101_motion.cli.param_types import port_option
from so101_motion.cli.shared import (
    CHECK_FAILED,
    STOPPED,
    aside,
    have_agreed,
    import_preview,
    print_json,
    quietly,
    tell_torque,
)
from so101_motion.cli.sources import MACHINE, MachineSource, chosen_among
from so101_motion.cli.view import PAGE, Page, keep_open
from so101_motion.common import interrupts
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT

if TYPE_CHECKING:
    from so101_motion.calib.motors.setup_view import SetupProgress, SetupView, Verification
    from so101_motion.cli.terminal import Terminal
    from so101_motion.setup.motor_operation import MotorOperation


@verb()
def setup(
    port: str | None = port_option(
        "Serial port, such as /dev/ttyACM0; by default the only servo adapter"
    ),
    joints: tuple[str, ...] = option(
        "Only this joint's motor; repeatable.",
        click.Choice([*ARM_JOINTS, GRIPPER_JOINT]),
        name="--joint",
        multiple=True,
    ),
    start_over: bool = flag("Start with the gripper again, even if motors are done."),
    repair: bool = flag("All motors of the arm: store sound settings for good. They go limp."),
    yes: bool = flag("Ask no questions; for scripts."),
    events: TextIO | None = EVENTS,
    web: bool = flag("In the browser: motors, calibration and final test."),
    page: Page = PAGE,
    machine: MachineSource | None = MACHINE,
    as_json: bool = JSON,
) -> None:
    """Give the motors of a new kit their ids, one at a time.

    New motors all have the id 1, so on one cable they cannot be distinguished. Connect each alone
    when you are asked for it; the rest happens by itself. At the end, with all six on the cable,
    everything is verified. You may stop at any time: the next start continues there.

    With --web a page in the browser leads you from the box of parts to a tested arm.

    \b
    so101 setup --web                  in the browser, even before anything is plugged in
    so101 setup --web --machine kit.local:8080   through a machine's calibration sensor
    so101 setup                        with the only servo adapter that is plugged in
    so101 setup --joint wrist_flex     after that motor was replaced
    so101 setup --repair               after so101 doctor has named a wrong setting
    so101 setup --port /tmp/so101      beside "so101 emulate --new --link /tmp/so101"
    """  # noqa: D301
    if chosen_among({"--port": port, "--machine": machine}) == "--port":
        machine = None
    if web:
        if joints or start_over or repair or yes or events or as_json:
            raise click.UsageError(
                "--web works only with --port or --machine, and the options of the page"
            )
        _in_browser(port, machine, page)
        return
    if machine is not None:
        raise click.UsageError("the motors of a machine are set up in the browser: add --web")
    from so101_motion.calib.motors.setup_view import PROGRESS_FILE, SetupProgress
    from so101_motion.cli.terminal import Quit, Terminal
    from so101_motion.files import user_storage
    from so101_motion.setup.calibrator import Calibrator

    report = port_choice.find_adapter(port)
    name = report.port.name
    if repair and (joints or start_over):
        raise click.UsageError("--repair goes with --port, --yes and --json only")
    if repair and not yes:
        have_agreed("The joints go limp, and settings are stored in them. Are you holding the arm?")
    progress = SetupProgress(user_storage.folder() / PROGRESS_FILE, name)
    if start_over:
        progress.clear()
    path = port_choice.calibration_file(None, report)
    with quietly(), closing(Calibrator.open(name, path)) as calibrator:
        motors = calibrator.motors
        with Terminal(ask=not yes, events=events) as terminal:
            terminal.say(f"motors on {name}", port=name)
            try:
                checked = None
                if repair:
                    for done in motors.repair()["changed"]:
                        terminal.say(done)
                    checked = motors.verify()
                elif len(report.joints) == 6 and not start_over and not joints:
                    terminal.say("all six motors answer already")
                    checked = motors.verify()
                else:
                    checked = _walk(motors, terminal, progress, joints)
            except KeyboardInterrupt:
                tell_torque(name, "no motor is driven; if the arm is put together, support it")
                raise interrupts.ToldInterrupt("the next so101 setup continues here") from None
            except Quit:
                terminal.say("stopped; the next so101 setup continues here", style="yellow")
                raise SystemExit(STOPPED) from None
        _conclude(name, motors.state, checked, as_json)


def _walk(
    motors: MotorOperation,
    terminal: Terminal,
    progress: SetupProgress,
    joints: tuple[str, ...],
) -> Verification | None:
    from so101_motion.calib.motors.setup_view import SETUP_ORDER
    from so101_motion.cli.operation_terminal import OperationTerminal
    from so101_motion.setup.motor_operation import ChainOperation

    motors.joints, motors.writes = joints or SETUP_ORDER, True
    motors.is_attended = terminal.is_manned
    motors.keep_in(progress)
    if progress.done and not joints:
        terminal.say(
            f"set up before: {', '.join(progress.done)}; continuing after them"
            " (--start-over starts with the gripper again)"
        )
    for joint in joints:
        motors.forget(joint)
    OperationTerminal(motors, terminal).go()
    if joints:
        return None
    terminal.say(motors.view.text)
    OperationTerminal(ChainOperation(motors, waits=True), terminal).go()
    if motors.checked is not None and motors.checked.ok:
        progress.clear()
    return motors.checked


def _in_browser(port: str | None, machine: MachineSource | None, page: Page) -> None:
    """Serve the setup page until Ctrl-C, which undoes a running calibration on a port."""
    viewer = import_preview()
    with ExitStack() as stack:
        stack.enter_context(quietly())
        opened = None if machine is None else stack.enter_context(machine.connect())
        served = viewer.serve_setup(
            ports=() if port is None or opened is not None else (port,),
            machine=opened,
            **page.server(f"setup of {machine.address if machine else port or 'a kit'}"),
        )
        try:
            keep_open(stack.enter_context(served), page)
        except KeyboardInterrupt:
            last_port = served.last_port or (port if machine is None else None)
            if last_port is not None:
                tell_torque(last_port)
            raise interrupts.ToldInterrupt("the next so101 setup --web continues here") from None


def _conclude(port: str, view: SetupView, checked: Verification | None, as_json: bool) -> None:
    sentence = view.status if checked is None else checked.sentence
    if as_json:
        print_json("setup", {"port": port, "sentence": sentence, **_facts(view, checked)})
    else:
        click.echo(sentence)
    for note in checked.notes if checked is not None else ():
        aside(f"note: {note}")
    if checked is None:
        aside("next: so101 doctor, once the whole arm is on the cable")
        return
    if checked.ok:
        aside("next: put the arm together, then so101 calibrate")
        return
    for check in checked.motors.values():
        if check.error:
            aside(f"error: {check.error}\n  try: {check.fix}")
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
