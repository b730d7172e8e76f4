"""HTML of the calibration's and the final test's pages. Every text passes ``escape``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from so101_motion.calib.procedure.summary import PoseHint, SummaryLine, Tone, TravelBar
from so101_motion.setup.accuracy import (
    JointAccuracy,
    MoveReport,
    degrees,
    millimetres,
    milliseconds,
    reasons,
)

from ..page.texts import capital
from .cards import BAD, DIM, GOOD, WARM

_COLOURS: dict[Tone, str] = {"good": GOOD, "busy": "#f0a500", "warm": WARM, "bad": BAD, "dim": DIM}
_VERDICTS: dict[str, tuple[str, Tone]] = {
    "ok": ("✓", "good"),
    "warn": ("!", "warm"),
    "fail": ("✗", "bad"),
    "not tested": ("–", "dim"),
}
_FIGURES = (
    "Off: how far each joint rests from its target. Sides: how much that depends on where it came"
    " from. Behind: how late it is in motion."
)
_BOX = "padding:.3em .8em;font-size:.85em;line-height:1.5"


def hints(items: Iterable[PoseHint]) -> str:
    """How near each joint is to the pose."""
    rows = "".join(
        f"<span>{escape(hint.joint)}</span>"
        f'<span style="color:{_COLOURS[hint.tone]};font-weight:600">{escape(hint.text)}</span>'
        for hint in items
    )
    return f'<div style="{_BOX};display:grid;grid-template-columns:8em 1fr">{rows}</div>'


def travels(items: Iterable[TravelBar]) -> str:
    """A bar for each joint."""
    return f'<div style="{_BOX}">{"".join(map(_travel, items))}</div>'


def _travel(item: TravelBar) -> str:
    colour = _COLOURS[item.tone]
    mark = ""
    if item.is_done:  # no tick for a travel that can be saved but is short
        mark = f'<b style="color:{colour}">{"!" if item.tone == "warm" else "✓"}</b>'
    at = ""
    if item.at is not None:
        at = (
            f'<i style="position:absolute;left:calc({100 * item.at:.1f}% - .17em);top:-.22em;'
            'width:.34em;height:1.14em;border-radius:.15em;background:currentColor"></i>'
        )
    text = (
        f'<div style="grid-column:2/-1;font-size:.92em;color:{colour};line-height:1.3">'
        f"{escape(capital(item.text))}</div>"
        if item.text
        else ""
    )
    return (
        f'<div role="meter" aria-label="{escape(item.joint)}" '
        f'aria-valuenow="{100 * (item.end - item.begin):.0f}" '
        'style="display:grid;grid-template-columns:1em 6.6em 1fr 5.6em;gap:0 .4em;'
        f'align-items:center;margin:.2em 0"><span>{mark}</span>'
        f"<span>{escape(item.joint)}</span>"
        '<span style="height:.7em;border-radius:.35em;background:#8884;position:relative">'
        f'<i style="position:absolute;left:{100 * item.begin:.1f}%;top:0;height:100%;'
        f"width:{100 * (item.end - item.begin):.1f}%;border-radius:.35em;"
        f'background:{colour}"></i>{at}</span>'
        '<span style="text-align:right;font-variant-numeric:tabular-nums">'
        f"{escape(item.figures)}</span>{text}</div>"
    )


def summary(lines: Iterable[SummaryLine]) -> str:
    """What will be saved, joint by joint, beside the values before."""
    rows = "".join(
        f"<tr><td>{escape(line.joint)}</td><td {_RIGHT}>{escape(line.travel)}</td>"
        f'<td style="color:{_COLOURS[line.tone]};font-weight:600;text-align:right">'
        f"{escape(line.quality)}</td>"
        f"<td {_RIGHT}>{escape(line.change)}</td></tr>"
        + (_below(line.reason, line.tone, 4) if line.reason else "")
        for line in lines
    )
    return _table(("joint", "travel", "quality", "change"), rows)


def report(joints: Sequence[JointAccuracy]) -> str:
    """The results of the test so far, joint by joint; empty as long as there are none.

    What is wrong with several joints is said once, under the last of them.
    """
    wrong, rows = reasons(joints), []
    if all(joint.error is None for joint in joints) and not wrong:
        return ""
    for joint in joints:
        mark, tone = _VERDICTS[joint.verdict]
        rows.append(
            f'<tr><td><b style="color:{_COLOURS[tone]}">{mark}</b> {escape(joint.joint)}</td>'
            + "".join(
                f"<td {_RIGHT}>{escape(text)}</td>"
                for text in (
                    degrees(joint.error),
                    degrees(joint.hysteresis),
                    milliseconds(joint.lag),
                )
            )
            + "</tr>"
        )
        alike = wrong.get(joint.sentence, [])
        if alike and alike[-1] == joint.joint:
            names = f"{', '.join(alike)}: " if len(alike) > 1 else ""
            rows.append(_below(f"{names}{joint.sentence}", tone, 4))
    return _table(("joint", "off", "sides", "behind"), "".join(rows))


def result(found: MoveReport) -> str:
    """The result of a test."""
    colour = GOOD if found.passed else BAD
    tool = "" if found.tool is None else f"The tool was at most {millimetres(found.tool)} off. "
    is_measured = any(joint.error is not None for joint in found.joints)
    return (
        f'<div style="{_BOX}"><b style="color:{colour};font-size:1.1em">'
        f"{escape(capital(found.sentence))}</b>"
        f'<div style="color:{DIM}">{escape(tool)}{_FIGURES if is_measured else ""}</div></div>'
    )


def saved(title: str, path: str, lines: Iterable[str]) -> str:
    """Where something was saved, with notes."""
    notes = "".join(
        f'<div style="color:{DIM};margin-top:.3em">{escape(capital(line))}</div>' for line in lines
    )
    return (
        f'<div style="{_BOX}"><b style="color:{GOOD}">{escape(title)}</b>'
        f'<div style="font-family:monospace;overflow-wrap:anywhere">{escape(path)}</div>{notes}'
        "</div>"
    )


def link(url: str, text: str) -> str:
    """A link to another page of ours."""
    return (
        f'<div style="{_BOX}"><a href="{escape(url)}" target="_blank" rel="noopener"'
        f' style="color:inherit;font-weight:600">{escape(text)}</a></div>'
    )


_RIGHT = 'style="text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap"'


def _table(heads: Iterable[str], rows: str) -> str:
    head = "".join(
        f'<th style="text-align:{"left" if k == 0 else "right"};font-weight:400;color:{DIM}">'
        f"{escape(name)}</th>"
        for k, name in enumerate(heads)
    )
    return (
        f'<div style="{_BOX}"><table style="width:100%;border-collapse:collapse;'
        f'border-spacing:0"><tr>{head}</tr>{rows}</table></div>'
    )


def _below(text: str, tone: Tone, span: int) -> str:
    return (
        f'<tr><td colspan="{span}" style="padding:0 0 .3em 1em;font-size:.92em;line-height:1.3;'
        f'color:{_COLOURS[tone]}">{escape(capital(text))}</td></tr>'
    )
