"""HTML of the setup pages. Every text passes ``escape``, as in ``markup.py``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from typing import Literal

from so101_motion.setup.checkup import Check
from so101_motion.setup.setup_steps import Workflow

from ..page.cards import AMBER, BAD, DIM, GOOD, PAD, WARM, marked
from .setup_context import TorqueText

Place = Literal["done", "passed over", "now", "left"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StepRow:
    """A line in the list of steps."""

    title: str
    place: Place  # whether it is done, passed over, on the page, or still to come
    minutes: int


_VERDICTS = {"ok": ("✓", GOOD), "warn": ("!", WARM), "fail": ("✗", BAD)}


def choice(workflow: Workflow) -> str:
    return (
        f'<div style="{PAD};padding-top:.7em;font-size:.88em;line-height:1.35">'
        f"{escape(workflow.purpose)}"
        f'<div style="color:{DIM};font-size:.92em">{escape(workflow.extent)}</div></div>'
    )


def step_list(rows: Iterable[StepRow]) -> str:
    steps = []
    for number, row in enumerate(rows, start=1):
        mark, weight, colour, back = {
            "done": ("✓", 400, GOOD, "transparent"),
            "passed over": ("!", 400, WARM, "transparent"),
            "now": (f"{number}", 700, "inherit", f"color-mix(in srgb,{AMBER} 22%,transparent)"),
            "left": (f"{number}", 400, DIM, "transparent"),
        }[row.place]
        steps.append(
            f'<span title="{row.minutes} min" style="padding:.1em .4em;border-radius:.3em;'
            f'white-space:nowrap;color:{colour};font-weight:{weight};background:{back}">'
            f"{mark} {escape(row.title)}</span>"
        )
    return (
        '<div class="so101-steplist" style="display:flex;flex-wrap:wrap;gap:.1em .2em;'
        'padding:.2em .45em;font-size:.82em">'
        f"{''.join(steps)}</div>"
    )


def torque(now: TorqueText) -> str:
    colour = AMBER if now.is_on else DIM
    return (
        f'<div style="{PAD};font-size:.85em;display:flex;gap:.5em;align-items:baseline">'
        f'<span style="flex:none;width:.65em;height:.65em;border-radius:50%;background:{colour}">'
        f"</span><span>{escape(now.text)}</span></div>"
    )


def link(url: str, text: str) -> str:
    return (
        f'<div style="{PAD};font-size:.85em"><a href="{escape(url)}" target="_blank" rel="noopener"'
        f' style="color:inherit;font-weight:600">{escape(text)}</a></div>'
    )


def check_text(check: Check) -> str:
    mark, colour = _VERDICTS[check.verdict]
    return marked(mark, colour, check.sentence, check.fix)
