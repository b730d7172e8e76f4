"""HTML of instructions, results and the rows of an operation. Every text passes ``escape``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from so101_motion.common.operation import Row, Tone

from .texts import capital

GOOD, BAD, WARM, DIM = (
    f"var(--so101-{name},{colour})"
    for name, colour in (
        ("good", "#2b8a3e"),
        ("bad", "#c92a2a"),
        ("warm", "#b35c00"),
        ("dim", "#868e96"),
    )
)
AMBER = "#f0a500"
PAD = "padding:.25em .8em"

COLOURS: dict[Tone, str] = {"good": GOOD, "busy": AMBER, "warm": WARM, "bad": BAD, "dim": DIM}


def instruction(title: str, text: str) -> str:
    return (
        f'<div style="{PAD};padding-top:.5em"><div style="font-weight:700">{escape(title)}</div>'
        f'<div style="font-size:.9em;line-height:1.4">{escape(text)}</div></div>'
    )


def going_on(text: str) -> str:
    return marked("…", DIM, text, "")


def failed(text: str) -> str:
    sentence, _, fix = text.rpartition("; ")
    return marked("✗", BAD, *((sentence, fix) if sentence else (fix, "")))


def note(text: str) -> str:
    return (
        f'<div style="{PAD};font-size:.8em;line-height:1.35;color:{DIM}">{escape(text)}</div>'
        if text
        else ""
    )


def enter(press: str) -> str:
    """Tell that Enter presses the button ``press``, which the front end then does."""
    return f'<div data-enter="{escape(press)}">{note("Enter does the same.")}</div>'


def marked(mark: str, colour: str, sentence: str, fix: str) -> str:
    todo = (
        f'<div style="margin-top:.15em"><b>Do this:</b> {escape(capital(fix))}</div>' if fix else ""
    )
    return (
        f'<div style="{PAD};font-size:.88em;line-height:1.4;display:grid;'
        'grid-template-columns:1.1em 1fr;overflow-wrap:anywhere">'
        f'<b style="color:{colour}">{mark}</b><div>{escape(capital(sentence))}{todo}</div></div>'
    )


def rows(columns: Sequence[str], items: Iterable[Row]) -> str:
    head = "".join(
        f'<th style="{_CELL};font-weight:400;color:{DIM}">{escape(c)}</th>' for c in columns
    )
    head = f"<tr><th></th><th></th>{head}</tr>" if head else ""
    return (
        f'<table style="margin:.3em .8em;width:calc(100% - 1.6em);font-size:.85em;line-height:1.5;'
        f'border-spacing:0">{head}{"".join(map(_row, items))}</table>'
    )


_CELL = "text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap;padding-left:.4em"


def _row(row: Row) -> str:
    colour = COLOURS[row.tone]
    bar = "" if row.bar is None else f"<td>{_bar(row, row.bar, colour)}</td>"
    colours = ("inherit" if bar else colour, *("inherit" for _ in row.cells))
    cells = "".join(
        f'<td style="{_CELL};color:{colour}">{escape(cell)}</td>'
        for cell, colour in zip(row.cells, colours, strict=False)
    )
    text = (
        f'<tr><td></td><td colspan="9" style="color:{colour};font-size:.92em;line-height:1.3;'
        'overflow-wrap:anywhere">'
        f"{escape(capital(row.text))}</td></tr>"
        if row.text
        else ""
    )
    return (
        f'<tr><td style="width:1.1em;color:{colour}"><b>{escape(row.mark)}</b></td>'
        f"<td>{escape(row.label)}</td>{bar}{cells}</tr>{text}"
    )


def _bar(row: Row, span: tuple[float, float], colour: str) -> str:
    begin, end = span
    at = (
        f'<i style="position:absolute;left:calc({100 * row.at:.1f}% - .17em);top:-.22em;'
        'width:.34em;height:1.14em;border-radius:.15em;background:currentColor"></i>'
        if row.at is not None
        else ""
    )
    return (
        f'<div role="meter" aria-label="{escape(row.label)}"'
        f' aria-valuenow="{100 * (end - begin):.0f}"'
        ' style="min-width:8em;height:.7em;border-radius:.35em;background:#8884;position:relative">'
        f'<i style="position:absolute;left:{100 * begin:.1f}%;top:0;height:100%;'
        f'width:{100 * (end - begin):.1f}%;border-radius:.35em;background:{colour}"></i>{at}</div>'
    )
