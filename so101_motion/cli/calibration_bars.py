"""Draw a running calibration in the terminal: a bar for each joint, and the result's table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rich.table import Table
from rich.text import Text

from so101_motion.calib.procedure.summary import TONES, SummaryLine
from so101_motion.calib.procedure.view import JointView

WIDTH = 32

_STYLES = {"dim": "dim", "busy": "cyan", "warm": "yellow", "good": "green", "bad": "red"}


def positions(joints: Mapping[str, JointView]) -> Table:
    """A table of the joints' positions."""
    table = Table.grid(padding=(0, 2))
    for joint, view in joints.items():
        where = "does not answer" if view.ticks is None else f"at {view.ticks} of 4095"
        style = "red" if view.ticks is None else "dim"
        table.add_row(Text(" "), Text(joint), Text(where, style=style))
    return table


def travels(joints: Mapping[str, JointView]) -> Table:
    """A table with a bar for each joint's travel so far."""
    table = Table.grid(padding=(0, 2))
    for joint, view in joints.items():
        style = _STYLES[TONES[view.verdict]]
        table.add_row(
            Text("✓" if view.is_done else " ", style="green"),
            Text(joint),
            bar(view, style),
            Text(view.sentence, style=style),
        )
    return table


def bar(view: JointView, style: str = "") -> Text:
    """A bar with a joint's travel so far, and its present position in it."""
    filled = round(view.share * WIDTH)
    cells = ["█"] * filled + ["·"] * (WIDTH - filled)
    lower, upper = view.recorded_min, view.recorded_max
    if view.ticks is not None and lower is not None and upper is not None and upper > lower:
        share = min(max((view.ticks - lower) / (upper - lower), 0.0), 1.0)
        cells[round(share * max(filled - 1, 0))] = "●"
    return Text("".join(cells), style=style)


def comparison(lines: Iterable[SummaryLine]) -> Table:
    """A table of the values to save, with the change of each joint."""
    table = Table(box=None, pad_edge=False)
    for heading in ("joint", "travel", "quality", "change"):
        table.add_column(heading, header_style="dim")
    for line in lines:
        quality = Text(line.quality, style=_STYLES[line.tone])
        table.add_row(line.joint, line.travel, quality, line.change)
    return table
