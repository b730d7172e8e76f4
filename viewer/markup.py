"""Small pieces of HTML for what viser has no widget for.

The only place that writes markup, and every text passes ``escape``: names and messages may come
from configurations and devices, and the page would run a script it finds in them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape

from .screen import Sentence, Tone

_TONES = {Tone.PLAIN: "inherit", Tone.GOOD: "#2b8a3e", Tone.BAD: "#e03131"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """A value between its limits, in the unit people read.

    Attributes:
        name: What it is.
        value: Where it stands.
        lower: Smallest possible value.
        upper: Largest possible value.
        unit: Written behind the value.
        warns: Whether it turns red near its limits; a closed gripper is nothing to warn of.
    """

    name: str
    value: float
    lower: float
    upper: float
    unit: str
    warns: bool = True

    @property
    def share(self) -> float:
        """How far up it stands, 0 at the lower limit to 1 at the upper."""
        share = (self.value - self.lower) / (self.upper - self.lower)
        return min(max(share, 0.0), 1.0)


NEAR_LIMIT = 0.03
"""Share of the range at either end where a bar turns red; chosen: 6 degrees of the pan joint."""


def sentence(said: Sentence) -> str:
    """One sentence, coloured by its tone."""
    return (
        '<div style="padding:.35em .7em .5em;min-height:3.7em;box-sizing:border-box;'
        f'font-size:.95em;line-height:1.35;font-weight:500;color:{_TONES[said.tone]}">{escape(said.text)}</div>'
    )


def headline(title: str, subtitle: str) -> str:
    """A word in large letters with a line of small print under it."""
    return (
        '<div style="padding:.4em .7em .2em">'
        f'<div style="font-size:1.15em;font-weight:700">{escape(title)}</div>'
        f'<div style="font-size:.8em;opacity:.7">{escape(subtitle)}</div></div>'
    )


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    """Names and values in two columns."""
    rows = "".join(
        f'<span style="opacity:.7">{escape(name)}</span><span>{escape(value)}</span>'
        for name, value in pairs
    )
    return (
        '<div style="display:grid;grid-template-columns:max-content 1fr;gap:.1em 1em;'
        f'padding:.2em .7em .4em;font-size:.82em">{rows}</div>'
    )


def bars(items: Iterable[Bar]) -> str:
    """Values between their limits, one below the other."""
    return f'<div style="padding:.3em .7em .5em">{"".join(map(_bar, items))}</div>'


def _bar(bar: Bar) -> str:
    near = bar.warns and min(bar.share, 1.0 - bar.share) < NEAR_LIMIT
    color = "#e03131" if near else "#f08c00"
    ends = f"{bar.lower:.0f} to {bar.upper:.0f} {bar.unit}"
    return (
        f'<div title="{escape(bar.name)}: {escape(ends)}" style="display:grid;'
        "grid-template-columns:7em 1fr 4.2em;gap:.6em;align-items:center;font-size:.82em;"
        f'line-height:1.9"><span>{escape(bar.name)}</span>'
        '<span style="height:.45em;border-radius:.25em;background:#8884;position:relative">'
        f'<i style="position:absolute;left:calc({100.0 * bar.share:.1f}% - .2em);top:-.2em;'
        f'width:.4em;height:.85em;border-radius:.2em;background:{color}"></i></span>'
        '<span style="text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap">'
        f"{_no_minus_zero(bar.value)} {escape(bar.unit)}</span></div>"
    )


def _no_minus_zero(value: float) -> str:
    text = f"{value:.1f}"
    return "0.0" if text == "-0.0" else text
