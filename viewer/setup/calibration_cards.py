"""HTML of the calibration's and the final test's pages. Every text passes ``escape``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from so101_motion.common.operation import Tone
from so101_motion.setup.accuracy import (
    JointAccuracy,
    MoveReport,
    degrees,
    millimetres,
    milliseconds,
    reasons,
)

from ..page.cards import BAD, COLOURS, DIM, GOOD
from ..page.texts import capital

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
            f'<tr><td><b style="color:{COLOURS[tone]}">{mark}</b> {escape(joint.joint)}</td>'
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
        f'color:{COLOURS[tone]}">{escape(capital(text))}</td></tr>'
    )
