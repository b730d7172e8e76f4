"""``so101 demo``: move the simulated arm, in the browser or in the terminal."""

from __future__ import annotations

import sys

import click
import numpy as np

from so101_motion.cli.options import flag, option, verb
from so101_motion.cli.plan_table import plan_table
from so101_motion.cli.shared import note_opened, stops_on_ctrl_c
from so101_motion.cli.sources import CellSource, Source
from so101_motion.cli.view import PAGE, Page, show
from so101_motion.common.units import to_mm

_DEMO_TARGET_MM = (250.0, 120.0, 150.0)


@verb()
def demo(
    text: bool = flag("Show a plan and the move in the terminal, no browser."),
    arms: int = option(
        "Number of arms; they share the space and keep apart.", click.IntRange(1, 8), 1
    ),
    page: Page = PAGE,
) -> None:
    """Run the simulated arm with its page in the browser; needs no hardware."""
    if text and arms > 1:
        raise click.UsageError("--text shows a single arm; leave out --arms")
    if text:
        _in_text()
    elif arms > 1:
        from so101_motion.files.cell_file import arms_in_a_circle

        file = arms_in_a_circle(arms)
        show(CellSource(file=file, title=f"{arms} simulated arms"), page)
    else:
        show(Source(port=None), page)


def _in_text() -> None:
    from so101_motion.planning.goals import PoseGoal
    from so101_motion.rig.simulated_rig import open_simulated

    x_mm, y_mm, z_mm = _DEMO_TARGET_MM
    goal = PoseGoal.at_point(np.array(_DEMO_TARGET_MM) / 1000.0)
    with note_opened("simulated arm", open_simulated()) as rig:
        plan = rig.arm.plan(goal)
        click.echo(f"Simulated arm: move the tool to ({x_mm:g}, {y_mm:g}, {z_mm:g}) mm\n")
        click.echo(plan_table(plan))
        click.echo("\nmoving ...", nl=False)
        sys.stdout.flush()
        motion = rig.arm.move(plan, wait=False)
        with stops_on_ctrl_c(rig.arm):
            motion.result()
        p = to_mm(rig.arm.T_base().p)
        off = float(np.linalg.norm(p - np.array(_DEMO_TARGET_MM)))
        click.echo(
            f" arrived at ({p[0]:.1f}, {p[1]:.1f}, {p[2]:.1f}) mm, {off:.2f} mm off (simulated)"
        )
        click.echo("\nnext: so101 demo        the same in the browser")
