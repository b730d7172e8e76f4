"""HTML of instructions, results and the rows of an operation. Every text passes ``escape``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from so101_motion.common.operation import Row, Tone

from .texts import capital


def instruction(title: str, text: str) -> str:
    return f'<div class="so101-card"><b>{escape(title)}</b><div>{escape(text)}</div></div>'


def going_on(text: str) -> str:
    return marked("…", "dim", text)


def failed(text: str) -> str:
    """An error, or an alert of several sentences; what to do, if it says so, begins a line."""
    said, _, rest = text.rpartition("; ")
    return marked("✗", "bad", *((said, rest) if said else (rest,)), is_fix=False)


def note(text: str, press: str | None = None) -> str:
    """Small print; with ``press`` also that Enter presses that button, which the browser does."""
    enter = f' data-enter="{escape(press)}"' if press else ""
    keys = ' <span class="so101-keys">The key Enter presses it.</span>' if press else ""
    return f'<div class="so101-note"{enter}>{escape(text)}{keys}</div>' if text else ""


def marked(mark: str, tone: Tone, sentence: str, rest: str = "", *, is_fix: bool = True) -> str:
    first = "<b>Do this:</b> " if is_fix else ""
    todo = f"<div>{first}{escape(capital(rest))}</div>" if rest else ""
    return (
        f'<div class="so101-marked"><b class="so101-{tone}">{mark}</b>'
        f"<div>{escape(capital(sentence))}{todo}</div></div>"
    )


def rows(columns: Sequence[str], items: Iterable[Row]) -> str:
    head = "".join(f"<th>{escape(c)}</th>" for c in columns)
    head = f"<tr><th></th><th></th>{head}</tr>" if head else ""
    return f'<table class="so101-rows">{head}{"".join(map(_row, items))}</table>'


def _row(row: Row) -> str:
    bar = "" if row.bar is None else f"<td>{_bar(row, row.bar)}</td>"
    cells = "".join(f'<td class="figure">{escape(cell)}</td>' for cell in row.cells)
    tone, text = f"so101-{row.tone}", escape(capital(row.text))
    below = f'<tr><td></td><td colspan="9" class="{tone}">{text}</td></tr>' if text else ""
    return (
        f'<tr class="{tone}"><td><b>{escape(row.mark)}</b></td>'
        f"<td>{escape(row.label)}</td>{bar}{cells}</tr>{below}"
    )


def _bar(row: Row, span: tuple[float, float]) -> str:
    begin, end = (100.0 * share for share in span)
    at = "" if row.at is None else f'<u style="left:{100 * row.at:.1f}%"></u>'
    return (
        f'<div role="meter" aria-label="{escape(row.label)}" aria-valuenow="{end - begin:.0f}">'
        f'<i style="left:{begin:.1f}%;width:{end - begin:.1f}%"></i>{at}</div>'
    )
