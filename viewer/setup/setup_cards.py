"""HTML of the setup pages. Every text passes ``escape``, as in ``markup.py``."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import Literal

from so101_motion.common.operation import Tone
from so101_motion.setup.checkup import Check
from so101_motion.setup.setup_steps import SetupStep, Workflow

from ..page.cards import marked

Place = Literal["done", "passed over", "now", "left"]


_VERDICTS: dict[str, tuple[str, Tone]] = {
    "ok": ("✓", "good"), "warn": ("!", "warm"), "fail": ("✗", "bad"),
}  # fmt: skip
_MARKS = {"done": "✓", "passed over": "!"}


def choice(workflow: Workflow) -> str:
    return (
        f'<div class="so101-choice">{escape(workflow.purpose)}'
        f"<small>{escape(workflow.extent)}</small></div>"
    )


def step_list(rows: Iterable[tuple[SetupStep, Place]]) -> str:
    steps = (
        f'<span title="{step.minutes} min" class="{place}">'
        f"{_MARKS.get(place, number)} {escape(step.title)}</span>"
        for number, (step, place) in enumerate(rows, start=1)
    )
    return f'<div class="so101-steplist">{"".join(steps)}</div>'


def link(url: str, text: str) -> str:
    return (
        f'<div class="so101-card"><a href="{escape(url)}" target="_blank" rel="noopener">'
        f"{escape(text)}</a></div>"
    )


def check_text(check: Check) -> str:
    return marked(*_VERDICTS[check.verdict], check.sentence, check.fix)
