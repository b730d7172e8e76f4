"""Write the report of a check as one HTML file with SVG plots, without external resources."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg
from so101_motion.tasks.datasets.check import CheckReport, angles
from so101_motion.tasks.datasets.moments import CONTACT, KINDS, Moment

MOST_PLOTS = 24  # how many moments are drawn; as many more are listed. Chosen.
_AROUND = 1.5  # [s] that are drawn before and after a moment
_MOST_POINTS = 400  # of a line
_WIDE, _HIGH = 640.0, 210.0  # of a plot [px]
_LEFT, _BELOW, _ABOVE = 44.0, 22.0, 26.0  # around its lines [px]
_ROW = 16.0  # of the overview [px]
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b")  # safe for colour blindness

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:60rem;padding:0 1rem;
 color:#1c2330;background:#fff}
h1{font-size:1.5rem;overflow-wrap:anywhere}h2{font-size:1.15rem;margin-top:2.2rem}
h3{font-size:1rem;margin:1.6rem 0 .2rem}
table{border-collapse:collapse}td,th{padding:.2rem .8rem .2rem 0;text-align:left;vertical-align:top}
td.n,th.n{text-align:right}p.note{border-left:4px solid #d55e00;padding-left:.8rem}
svg{display:block;max-width:100%;height:auto}svg text{font:11px system-ui,sans-serif;fill:#4a5568}
.quiet{color:#4a5568}
@media(prefers-color-scheme:dark){body{background:#14181f;color:#e6e9ee}.quiet{color:#a7b0bd}
 svg text{fill:#a7b0bd}}
"""


_Excerpt = tuple[Array, Array, Array | None]  # times [s], angles as sent and as measured [deg]


def html_report(report: CheckReport) -> bytes:
    """The report as HTML; reads the episodes of the worst moments once more."""
    root = report.data_set.metadata.root
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8>",
        "<meta name=viewport content='width=device-width'>",
        f"<title>{escape(root.name)}: check</title><style>{_STYLE}</style>",
        f"<h1>{escape(str(root))}</h1>",
        f"<p>{'.<br>'.join(map(escape, report.headlines))}.</p>",
        *(f"<p class=note>{escape(note)}</p>" for note in report.notes),
        _findings(report),
        _differences(report),
        *_worst(report),
    ]
    return "\n".join(parts).encode()


def _findings(report: CheckReport) -> str:
    if not report.moments:
        return "<h2>Findings</h2><p>Nothing wrong was found.</p>"
    fps = report.data_set.metadata.fps
    rows = [
        f"<tr><td class=n>{report.counts[kind]}<td>{kind}<td class=n>"
        f"{report.frames_of.get(kind, 0) / fps:.1f} s<td class=quiet>{words}"
        for kind, words in KINDS.items()
        if report.counts.get(kind)
    ]
    return f"<h2>Findings</h2><table>{''.join(rows)}</table>{_overview(report)}"


def _overview(report: CheckReport) -> str:
    """Draw where in the data set the worst moments are, a row for each kind."""
    kinds = [kind for kind in KINDS if report.counts.get(kind)]
    numbers = list(report.lengths)
    begins = np.concatenate([[0], np.cumsum(list(report.lengths.values()))])
    place = {number: int(begin) for number, begin in zip(numbers, begins, strict=False)}
    scale = (_WIDE - 90.0) / max(report.frames, 1)
    marks = []
    for row, kind in enumerate(kinds):
        y = row * _ROW + 4.0
        marks.append(f"<text x=0 y={y + 10:.0f}>{kind}</text>")
        marks.append(f"<rect x=90 y={y + 5:.0f} width={_WIDE - 90:.0f} height=1 fill=#8888 />")
        for moment in report.moments:
            if moment.kind == kind:
                x = 90.0 + scale * (place[moment.episode] + moment.first)
                width = max(scale * (moment.last - moment.first + 1), 2.0)
                marks.append(
                    f"<rect x={x:.1f} y={y:.0f} width={width:.1f} height=11 fill=#d55e00 />"
                )
    high = len(kinds) * _ROW + 22.0
    end_min = report.frames / report.data_set.metadata.fps / 60.0
    marks.append(f"<text x=90 y={high - 5:.0f}>0</text>")
    marks.append(f"<text x={_WIDE:.0f} y={high - 5:.0f} text-anchor=end>{end_min:.1f} min</text>")
    return _svg(_WIDE, high, marks, "when in the data set the worst moments are")


def _differences(report: CheckReport) -> str:
    off = report.differences
    if off is None:
        return "<p>The measured joint angles were not recorded.</p>"
    rows = [
        f"<tr><td>{joint}<td class=n>{rms:.2f}<td class=n>{off.mean_deg[joint]:.2f}"
        f"<td class=n>{off.worst_deg[joint]:.2f}"
        for joint, rms in off.rms_deg.items()
    ]
    return (
        "<h2>Difference between where the joints were and where they were sent</h2>"
        f"<p>They are {1000.0 * off.lag_s:.0f} ms late. Without that lag, in degrees:</p>"
        "<table><tr><th>joint<th class=n>rms<th class=n>mean (droop)<th class=n>worst"
        f"{''.join(rows)}</table>"
    )


def _worst(report: CheckReport) -> Iterable[str]:
    if not report.moments:
        return
    yield "<h2>The worst moments</h2>"
    yield "<p class=quiet>Solid: where joints were sent. Dashed: where they were. Degrees.</p>"
    excerpts = _excerpts(report)
    for place, moment in enumerate(report.moments[:MOST_PLOTS], start=1):
        yield (
            f"<h3>{place}. Episode {moment.episode}, {moment.t:.2f} s:"
            f" {escape(moment.sentence)}</h3>{_plot(moment, *excerpts[id(moment)])}"
        )
    rest = report.moments[MOST_PLOTS : 2 * MOST_PLOTS]
    if rest:
        yield "<h3>Further moments</h3><table>"
        for moment in rest:
            yield (
                f"<tr><td>episode {moment.episode}<td class=n>{moment.t:.2f} s"
                f"<td>{escape(moment.sentence)}"
            )
        yield "</table>"


def _excerpts(report: CheckReport) -> dict[int, _Excerpt]:
    """The joints around the worst moments, by the moment's ``id``."""
    fps, moments = report.data_set.metadata.fps, report.moments[:MOST_PLOTS]
    around = round(_AROUND * fps)
    wanted, found = {moment.episode for moment in moments}, {}
    for episode in (each for each in report.data_set.episodes() if each.index in wanted):
        action, state = angles(report.data_set, report.units, episode)
        for moment in (each for each in moments if each.episode == episode.index):
            begin = max(min(moment.frame, moment.first) - around, moment.frame - 4 * around, 0)
            end = min(max(moment.frame, moment.last) + around, moment.frame + 4 * around)
            k = np.arange(begin, min(end + 1, len(episode)))
            k = k[:: max(1, -(-len(k) // _MOST_POINTS))]
            state_deg = None if state is None else to_deg(state[k, :5])
            found[id(moment)] = k / fps, to_deg(action[k, :5]), state_deg
    return found


def _plot(moment: Moment, t: Array, action_deg: Array, state_deg: Array | None) -> str:
    joints = [ARM_JOINTS.index(moment.what)] if moment.what in ARM_JOINTS else list(range(5))
    drawn = [(action_deg, ""), (state_deg, " stroke-dasharray='5 3'")]
    if moment.kind == CONTACT:
        drawn = [each for k, each in enumerate(drawn) if (moment.of == "state") == (k == 1)]
    lines = [(x[:, i], i, dash) for x, dash in drawn if x is not None for i in joints]
    finite = np.concatenate([y[np.isfinite(y)] for y, *_ in lines])
    if not len(finite) or len(t) < 2:
        return "<p class=quiet>There are no numbers to draw.</p>"
    low, high = float(finite.min()), float(finite.max())
    low, high = (low - 1.0, high + 1.0) if high - low < 2.0 else (low, high)
    across = (_WIDE - _LEFT) / float(t[-1] - t[0])
    up = (_HIGH - _BELOW - _ABOVE) / (high - low)

    def x_at(time: float) -> float:
        return _LEFT + (time - float(t[0])) * across

    def y_at(angle: float) -> float:
        return _HIGH - _BELOW - (angle - low) * up

    fps = (len(t) - 1) / (t[-1] - t[0])
    begin = x_at(max(moment.t - (moment.frame - moment.first) / fps, float(t[0])))
    end = x_at(min(moment.t + (moment.last - moment.frame) / fps, float(t[-1])))
    width, tall = max(end - begin, 2.0), f"y={_ABOVE:.0f} height={_HIGH - _BELOW - _ABOVE:.0f}"
    marks = [
        f"<rect x={begin:.1f} width={width:.1f} {tall} fill=#d55e0022 />",
        f"<rect x={x_at(moment.t):.1f} width=1 {tall} fill=#d55e00 />",
    ]
    right = _WIDE - _LEFT
    for angle in np.linspace(low, high, 4):
        y = y_at(angle)
        marks += [
            f"<text x={_LEFT - 6:.0f} y={y + 4:.1f} text-anchor=end>{angle:.0f}</text>",
            f"<rect x={_LEFT:.0f} y={y:.1f} width={right:.0f} height=1 fill=#8883 />",
        ]
    for time in np.linspace(t[0], t[-1], 6):
        anchor = "end" if time == t[-1] else "middle"
        x = x_at(time)
        marks.append(f"<text x={x:.1f} y={_HIGH - 6:.0f} text-anchor={anchor}>{time:.1f} s</text>")
    for values, i, dash in lines:
        how = f"fill=none stroke={_COLORS[i]} stroke-width=1.6{dash}"
        for piece in _pieces(t, values):
            points = " ".join(f"{x_at(a):.1f},{y_at(b):.1f}" for a, b in piece)
            marks.append(f"<polyline points='{points}' {how} />")
    legend = " ".join(f"<tspan fill={_COLORS[i]}>&#9632; {ARM_JOINTS[i]}</tspan>" for i in joints)
    marks.append(f"<text x={_LEFT + 6:.0f} y=14>{legend}</text>")
    return _svg(_WIDE, _HIGH, marks, moment.sentence)


def _pieces(t: Array, y: Array) -> Iterable[Array]:
    """The stretches of a line that are known, each of shape (m, 2)."""
    known = np.isfinite(y)
    for piece in np.split(np.arange(len(y)), np.flatnonzero(np.diff(known)) + 1):
        if len(piece) and known[piece[0]]:
            yield np.column_stack([t[piece], y[piece]])


def _svg(width: float, height: float, marks: Iterable[str], label: str) -> str:
    return (
        f"<svg viewBox='0 0 {width:.0f} {height:.0f}' width={width:.0f} height={height:.0f}"
        f" role=img aria-label='{escape(label)}'>{''.join(marks)}</svg>"
    )
