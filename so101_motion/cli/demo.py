"""``so101 demo``: the simulated arm with the preview, or as text."""

from __future__ import annotations

import signal
import sys
import threading

import click
import numpy as np

from so101_motion.cli.shared import import_preview, reports_errors
from so101_motion.cli.tables import plan_table
from so101_motion.units import to_mm

_DEMO_TARGET_MM = (250.0, 120.0, 150.0)


@click.command()
@click.option("--text", is_flag=True, help="Show a plan and the move in the terminal, no browser.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address the page listens on.")
@click.option("--web-port", default=8080, show_default=True, help="Port the page listens on.")
@click.option("--allow-remote", is_flag=True, help="Let --host be more than this machine alone.")
@reports_errors
def demo(text: bool, host: str, web_port: int, allow_remote: bool) -> None:
    """Run the simulated arm with the preview in the browser; needs no hardware."""
    if text:
        _in_text()
    else:
        _in_browser(host, web_port, allow_remote)


def _in_browser(host: str, web_port: int, allow_remote: bool) -> None:
    from so101_motion.rig import open_simulated

    serve = import_preview()
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


def _in_text() -> None:
    from so101_motion.planning.goals import PoseGoal
    from so101_motion.rig import open_simulated

    x_mm, y_mm, z_mm = _DEMO_TARGET_MM
    goal = PoseGoal.at_point(np.array(_DEMO_TARGET_MM) / 1000.0)
    with open_simulated() as rig:
        plan = rig.arm.plan(goal)
        click.echo(f"Simulated arm: bring the tool to ({x_mm:g}, {y_mm:g}, {z_mm:g}) mm\n")
        click.echo(plan_table(plan))
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
