"""``so101 demo``: the simulated arm with the preview, or as text."""

from __future__ import annotations

import sys

import click
import numpy as np

from so101_motion.cli.plan_table import plan_table
from so101_motion.cli.shared import INTERRUPTED
from so101_motion.cli.sources import Source
from so101_motion.cli.view import Page, page_options, show
from so101_motion.common.units import to_mm

_DEMO_TARGET_MM = (250.0, 120.0, 150.0)


@click.command()
@click.option("--text", is_flag=True, help="Show a plan and the move in the terminal, no browser.")
@page_options
def demo(text: bool, page: Page) -> None:
    """Run the simulated arm with the preview in the browser; needs no hardware."""
    if text:
        _in_text()
    else:
        show(Source(port=None), page)


def _in_text() -> None:
    from so101_motion.planning.goals import PoseGoal
    from so101_motion.rig.hardware_rig import open_simulated

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
            raise SystemExit(INTERRUPTED) from None
        p = to_mm(rig.arm.T_base().p)
        off = float(np.linalg.norm(p - np.array(_DEMO_TARGET_MM)))
        click.echo(
            f" arrived at ({p[0]:.1f}, {p[1]:.1f}, {p[2]:.1f}) mm, {off:.2f} mm off (simulated)"
        )
        click.echo("\nnext: so101 demo        the same in the browser")
