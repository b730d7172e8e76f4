"""`so101 …`: parse, call, print. Degrees and millimetres live here.

Exit codes: 0 ok, 1 unexpected, 2 wrong usage, 3 no device or no port, 5 unreachable or no plan,
7 stopped, 130 Ctrl-C.
"""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TextIO

import click
import numpy as np

from so101_motion import __version__
from so101_motion.errors import ConfigError, Interrupted, PlanningError, So101Error
from so101_motion.state import ARM_JOINTS
from so101_motion.units import to_deg, to_mm

if TYPE_CHECKING:
    from so101_motion.planning.plan import Plan

_DEMO_TARGET_MM = (250.0, 120.0, 150.0)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="so101")
def main() -> None:
    """Motion for the SO-101 arm: planned, timed, stoppable."""


@main.command()
@click.option("--text", is_flag=True, help="Show a plan and the move in the terminal, no browser.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address the page listens on.")
@click.option("--web-port", default=8080, show_default=True, help="Port the page listens on.")
@click.option("--allow-remote", is_flag=True, help="Let --host be more than this machine alone.")
def demo(text: bool, host: str, web_port: int, allow_remote: bool) -> None:
    """Run the simulated arm with the preview in the browser; needs no hardware."""
    try:
        if text:
            _demo_in_text()
        else:
            _demo_in_browser(host, web_port, allow_remote)
    except So101Error as error:
        _fail(error)


def _demo_in_browser(host: str, web_port: int, allow_remote: bool) -> None:
    from so101_motion.rig import open_simulated

    try:
        from so101_viewer import serve
    except ImportError as error:
        raise click.ClickException(
            f"the preview needs viser, which could not be imported: {error}\n"
            "try: pip install --force-reinstall so101-motion, or so101 demo --text"
        ) from error

    done = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: done.set())
    with (
        open_simulated() as rig,
        serve(rig, host=host, port=web_port, allow_remote=allow_remote) as page,
    ):
        click.echo("so101: simulated arm ready", err=True)
        click.echo(f"open   {page.url}")
        click.echo("       (whoever has this link can move the arm; Ctrl-C to quit)", err=True)
        done.wait()
        click.echo("\nso101: stopping", err=True)


def _demo_in_text() -> None:
    from so101_motion.planning.goals import PoseGoal
    from so101_motion.rig import open_simulated

    x_mm, y_mm, z_mm = _DEMO_TARGET_MM
    goal = PoseGoal.at_point(np.array(_DEMO_TARGET_MM) / 1000.0)
    with open_simulated() as rig:
        plan = rig.arm.plan(goal)
        click.echo(f"Simulated arm: bring the tool to ({x_mm:g}, {y_mm:g}, {z_mm:g}) mm\n")
        click.echo(describe_plan(plan))
        click.echo("\nmoving ...", nl=False)
        sys.stdout.flush()
        motion = rig.arm.start_execute(plan)
        try:
            motion.result()
        except KeyboardInterrupt:
            rig.arm.stop()
            click.echo(" stopped")
            raise SystemExit(130) from None
        p = to_mm(rig.arm.T_base().p)
        off = float(np.linalg.norm(p - np.array(_DEMO_TARGET_MM)))
        click.echo(
            f" arrived at ({p[0]:.1f}, {p[1]:.1f}, {p[2]:.1f}) mm, {off:.2f} mm off (simulated)"
        )
        click.echo("\nnext: so101 demo        the same in the browser")


@main.command()
@click.option("--link", type=click.Path(path_type=Path), help="A link that leads to the port.")
@click.option("--ids", default="1-6", show_default=True, help="Who is there: 1-6, 1-3,5, 6=1.")
@click.option("--realtime", is_flag=True, help="Bytes take the time they take on a wire.")
@click.option("--latency", default=0.0, metavar="S", help="The adapter holds replies this long.")
@click.option("--loss", default=0.0, metavar="P", help="Share of replies that get lost.")
@click.option("--corrupt", default=0.0, metavar="P", help="Share of replies with a flipped bit.")
@click.option("--fault", "faults", multiple=True, help="Such as dead:3 or unplug@4+2; repeatable.")
@click.option("--hand", type=click.File(), help="A script that moves limp joints by hand.")
def emulate(
    link: Path | None,
    ids: str,
    realtime: bool,
    latency: float,
    loss: float,
    corrupt: float,
    faults: tuple[str, ...],
    hand: TextIO | None,
) -> None:
    """Put six virtual servos behind a serial port until Ctrl-C; faults can be typed while it runs.

    Prints the port. Any program that talks to STS3215 servos can open it.
    """
    from so101_motion.drivers.emulator import emulator, pty_port, run
    from so101_motion.drivers.emulator import faults as fault_names
    from so101_motion.planning.model import RobotModel

    done = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: done.set())
    try:
        options = emulator.EmulatorOptions(
            link=link,
            ids=emulator.parse_ids(ids),
            pacing=pty_port.Pacing(realtime=realtime, latency=latency),
            wire=fault_names.WireFaults(loss=loss, corrupt=corrupt),
            faults=tuple(fault_names.parse_fault(text) for text in faults),
            hand=hand.read() if hand is not None else "",
        )
        run.run_emulator(
            options,
            announce=click.echo,
            stop=done,
            commands=sys.stdin,
            gravity=RobotModel.load().gravity_torque,
        )
    except So101Error as error:
        _fail(error)


def describe_plan(plan: Plan) -> str:
    """A plan as a table for the terminal: travel, peak speed and speed over time per joint."""
    trajectory = plan.trajectory
    travel_deg = to_deg(trajectory.q[-1] - trajectory.q[0])
    peak_deg = to_deg(np.max(np.abs(trajectory.qd), axis=0))
    tool_mm = float(to_mm(np.sum(np.linalg.norm(np.diff(plan.tool_path, axis=0), axis=1))))
    planned_ms = plan.report.stages_ms["total"]
    lines = [
        f"{plan.duration:.2f} s, {len(trajectory)} setpoints {1e3 * trajectory.dt:g} ms apart, "
        f"tool path {tool_mm:.0f} mm, planned in {planned_ms:.1f} ms",
        "",
        f"{'joint':<14}{'travel':>10}{'peak speed':>13}   speed over time",
    ]
    for i, joint in enumerate(ARM_JOINTS):
        lines.append(
            f"{joint:<14}{travel_deg[i]:>6.1f} deg{peak_deg[i]:>7.1f} deg/s   "
            + _sparkline(np.abs(trajectory.qd[:, i]), float(np.max(plan.limits.velocity)))
        )
    return "\n".join(lines)


def _sparkline(values: np.ndarray, top: float, width: int = 40) -> str:
    bars = " ▁▂▃▄▅▆▇█"
    columns = [float(np.max(part)) for part in np.array_split(values, min(width, len(values)))]
    return "".join(bars[round(min(value / top, 1.0) * (len(bars) - 1))] for value in columns)


def _fail(error: So101Error) -> NoReturn:
    click.echo(f"error: {error}", err=True)
    if isinstance(error, PlanningError):
        raise SystemExit(5)
    if isinstance(error, Interrupted):
        raise SystemExit(7)
    raise SystemExit(3 if isinstance(error, ConfigError) else 1)


if __name__ == "__main__":
    main()
