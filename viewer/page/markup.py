"""Small pieces of HTML for what viser has no widget for.

Every text is escaped, because names and messages may come from configurations and devices.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable
from html import escape
from typing import NamedTuple

from .events import Event
from .screen_state import Sentence
from .texts import capital

ROUNDED = 0.01
"""A limit so near to a whole number is shown as that; others are rounded inwards [deg, %]."""

NEAR_LIMIT = 0.03
"""Share of the range at either end where a gauge turns red; chosen: 6 degrees of the pan joint."""


def sentence(sentence: Sentence) -> str:
    """One sentence, whole, coloured by its tone; there is room for three lines.

    What it says of keys is left out where a finger taps.
    """
    text = escape(sentence.text)
    for keys in ("Space or ", " or its key"):
        text = text.replace(keys, f'<span class="so101-keys">{keys}</span>')
    return f'<div class="so101-says so101-{sentence.tone.value}">{text}</div>'


def headline(title: str, subtitle: str, *, is_under_way: bool) -> str:
    """A setup's title and step; while it is shown, a double click counts once.

    While it is under way, the front end keeps the last three widgets in view: Next, Back, Abort.
    """
    kind = "so101-once so101-wizard" if is_under_way else "so101-once"
    return (
        f'<div class="so101-headline {kind}"><b>{escape(title)}</b>'
        f"<small>{escape(subtitle)}</small></div>"
    )


def facts(rows: Iterable[tuple[str, str]], *, lines: int = 0, bad: Collection[str] = ()) -> str:
    """Names and values; the values of the names in ``bad`` are red.

    Room for ``lines`` lines is reserved, so that what stands below does not move.
    """
    cells = "".join(
        f"<i>{escape(name)}</i><span{' class=so101-bad' * (name in bad)}>{escape(value)}</span>"
        for name, value in rows
    )
    return f'<div class="so101-facts" style="--lines:{lines}">{cells}</div>'


def small(text: str) -> str:
    return f'<div class="so101-small">{escape(text)}</div>'


def caption(text: str, is_old: bool) -> str:
    old = " so101-old" if is_old else ""
    return f'<div class="so101-caption{old}">{escape(text)}</div>'


def picture(url: str | None, trouble: str) -> str:
    """A camera's picture, a ``data:`` address; grey, with what is wrong, when it is old."""
    image = f'<img alt="The camera\'s picture" src="{escape(url)}">' if url else ""
    what = "No new picture" if url else "No picture"
    # no line ends within an option such as -aG
    whole = re.sub(r"(?<= )-\w+", r"<span>\g<0></span>", escape(capital(f"{what}: {trouble}")))
    said = f'<div class="so101-warning">{whole}</div>' if trouble else ""
    return f'<div class="so101-picture">{image}{said}</div>'


def to_copy(about: str, text: str) -> str:
    """A text with a button that copies it; works without https as well."""
    copy = (
        "const t=this.previousElementSibling;t.select();"
        "if(document.execCommand('copy'))this.textContent='Copied';t.blur()"  # Space stops again
    )
    return (
        f'<div class="so101-to-copy"><div>{escape(about)}</div>'
        f'<textarea readonly aria-label="{escape(about)}" spellcheck="false">{escape(text)}'
        "</textarea>"
        f'<button type="button" class="so101-copy" onclick="{escape(copy)}">Copy</button></div>'
    )


def events(items: Iterable[Event]) -> str:
    rows = "".join(
        f"<i>{event.at:%H:%M:%S}</i>"
        f'<span class="so101-{event.tone.value}">{escape(event.text)}</span>'
        for event in items
    )
    region = 'role="region" aria-label="Events" tabindex="0"'  # keys scroll it
    return f'<div class="so101-events" {region}>{rows}</div>'


class Span(NamedTuple):
    """A piece of a timeline: its name, begin and end as shares of the whole, and how deep it is."""

    name: str
    begins: float
    ends: float
    depth: int = 0


class Timeline(NamedTuple):
    """The steps of a program in order, its loops, and its duration [s]."""

    parts: tuple[Span, ...]
    loops: tuple[Span, ...]
    duration: float


MOST_PARTS = 120
"""With more steps than this no name could be read, so the line is drawn empty; chosen."""


def timeline(line: Timeline | None, seek: str | None) -> str:
    """A timeline; a finger or a mouse on it sends the time [s] to the widget ``seek``."""
    if line is None:
        return '<div class="so101-timeline"></div>'
    parts = line.parts if len(line.parts) <= MOST_PARTS else ()
    drawn = [("b", "", span) for span in parts]
    drawn += [("i", f" deep{span.depth}", span) for span in line.loops]
    pieces = "".join(
        f'<{tag} class="span{kind}" style="left:{100.0 * begins:.2f}%;'
        f'width:{100.0 * (ends - begins):.2f}%">{escape(name)}</{tag}>'
        for tag, kind, (name, begins, ends, _) in drawn
    )
    said = ", ".join(f"{name} to {ends * line.duration:.1f} s" for name, _, ends, _ in parts)
    return (
        f'<div class="so101-timeline" role="img" aria-label="Timeline: {escape(said)}"'
        f' data-seek="{escape(seek or "")}" data-duration="{line.duration:.3f}">'
        f"{pieces}<u></u></div>"
    )


def steps(
    rows: Iterable[tuple[str, str, int]],
    *,
    chosen: int | None,
    active: int | None,
    press: str | None,
    move: str | None,
) -> str:
    """A list of steps to choose from: a name, small print, and how many loops each is in.

    The index of the one that is edited is ``chosen``, of the one that is being done ``active``. The
    widget ``press`` receives the number of a row that is pressed, ``move`` which was dragged where.
    """
    lines = []
    for k, (name, rest, depth) in enumerate(rows):
        kind = f"loop{depth}" + (" chosen" if k in (chosen, active) else "")
        mark = "▶" if k == active else f"{k + 1}"
        lines.append(
            f'<button type="button" class="{kind}" data-press="{escape(press or "")}"'
            f' data-value="{k + 1}"><i>{mark}</i><span>{escape(name)}</span>'
            f"<small>{escape(rest)}</small></button>"
        )
    return f'<div class="so101-steps" data-move="{escape(move or "")}">{"".join(lines)}</div>'


def gauge(
    name: str,
    value: float,
    lower: float,
    upper: float,
    *,
    unit: str = "°",
    warns: bool = True,
    is_old: bool = False,
) -> str:
    """A value between its limits, in the unit that is shown.

    It turns red near its limits if it ``warns``; a closed gripper is nothing to warn of. It is dim
    if it ``is_old``, because its servo does not answer.
    """
    share = min(max((value - lower) / (upper - lower), 0.0), 1.0)
    near = " old" if is_old else " near" if warns and min(share, 1.0 - share) < NEAR_LIMIT else ""
    least, most = math.ceil(lower - ROUNDED), math.floor(upper + ROUNDED)
    ends = f"{least} to {most} {unit}"
    return (
        f'<div class="so101-gauge{near}" title="{escape(name)}: {escape(ends)}">'
        f'<span>{escape(name)}</span><div><i style="left:{100.0 * share:.1f}%"></i>'
        f"<small>{least}</small><small>{most}</small></div>"
        f"<b>{round(value, 1) + 0.0:.1f} {escape(unit)}</b></div>"
    )
