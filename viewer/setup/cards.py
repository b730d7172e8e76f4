"""HTML of the setup pages. Every text passes ``escape``, as in ``markup.py``."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import Literal

from so101_motion.calib.motors.setup_view import MotorCheck, MotorView, Verification
from so101_motion.setup.checkup import Check
from so101_motion.setup.port_selection import Candidate
from so101_motion.setup.setup_steps import Workflow

from ..page.texts import capital
from .step_wizard import StepRow
from .torque import TorqueText

MotorLook = Literal["waiting", "now", "found", "trouble", "done", "skipped"]

GOOD, BAD, WARM, DIM = (
    f"var(--so101-{name},{colour})"
    for name, colour in (
        ("good", "#2b8a3e"),
        ("bad", "#c92a2a"),
        ("warm", "#b35c00"),
        ("dim", "#868e96"),
    )
)
_AMBER = "#f0a500"
_PAD = "padding:.25em .8em"

_VERDICTS = {"ok": ("✓", GOOD), "warn": ("!", WARM), "fail": ("✗", BAD)}


def choice(workflow: Workflow) -> str:
    """The description of a workflow, shown before it is chosen."""
    return (
        f'<div style="{_PAD};padding-top:.7em;font-size:.88em;line-height:1.35">'
        f"{escape(workflow.purpose)}"
        f'<div style="color:{DIM};font-size:.92em">{escape(workflow.extent)}</div></div>'
    )


def step_list(rows: Iterable[StepRow]) -> str:
    """The list of steps: done, current, to come; compact."""
    steps = []
    for number, row in enumerate(rows, start=1):
        mark, weight, colour, back = {
            "done": ("✓", 400, GOOD, "transparent"),
            "passed over": ("!", 400, WARM, "transparent"),
            "now": (f"{number}", 700, "inherit", f"color-mix(in srgb,{_AMBER} 22%,transparent)"),
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
    """Whether the joints are held; always visible."""
    colour = _AMBER if now.is_on else DIM
    return (
        f'<div style="{_PAD};font-size:.85em;display:flex;gap:.5em;align-items:baseline">'
        f'<span style="flex:none;width:.65em;height:.65em;border-radius:50%;background:{colour}">'
        f"</span><span>{escape(now.text)}</span></div>"
    )


def instruction(title: str, text: str) -> str:
    """The instruction of this step."""
    return (
        f'<div style="{_PAD};padding-top:.5em"><div style="font-weight:700">{escape(title)}</div>'
        f'<div style="font-size:.9em;line-height:1.4">{escape(text)}</div></div>'
    )


def check_text(check: Check) -> str:
    """The result of a check and what to do."""
    mark, colour = _VERDICTS[check.verdict]
    return _marked(mark, colour, check.sentence, check.fix)


def good(text: str) -> str:
    """What has come out well, and what to do now."""
    return _marked("✓", GOOD, text, "")


def going_on(text: str) -> str:
    """What is being done now."""
    return _marked("…", DIM, text, "")


def failed(text: str) -> str:
    """An error and what to do about it."""
    sentence, _, fix = text.rpartition("; ")
    return _marked("✗", BAD, *((sentence, fix) if sentence else (fix, "")))


def note(text: str) -> str:
    """Small print."""
    return (
        f'<div style="{_PAD};font-size:.8em;line-height:1.35;color:{DIM}">{escape(text)}</div>'
        if text
        else ""
    )


def _marked(mark: str, colour: str, sentence: str, fix: str) -> str:
    todo = (
        f'<div style="margin-top:.15em"><b>Do this:</b> {escape(capital(fix))}</div>' if fix else ""
    )
    return (
        f'<div style="{_PAD};font-size:.88em;line-height:1.4;display:grid;'
        'grid-template-columns:1.1em 1fr;overflow-wrap:anywhere">'
        f'<b style="color:{colour}">{mark}</b><div>{escape(capital(sentence))}{todo}</div></div>'
    )


def port(candidate: Candidate, *, is_chosen: bool) -> str:
    """A port: its name, what is on it, and its voltage against the servos' rated one."""
    report = candidate.report
    names = " · ".join(name for name in (report.port.device, report.port.description) if name)
    volts = ""
    if report.volts is not None and report.nominal_volts is not None:
        colour = BAD if report.supply_trouble else GOOD
        volts = (
            f'<div>Supply: <b style="color:{colour}">{report.volts:.1f} V</b>'
            f" for a {report.nominal_volts:g} V arm</div>"
        )
    edge = _AMBER if is_chosen else "#8884"
    return (
        f'<div style="margin:.35em .8em;padding:.45em .6em;border:1px solid {edge};'
        'border-radius:.4em;font-size:.85em;line-height:1.4;overflow-wrap:anywhere">'
        f"<b>{escape(candidate.name)}</b>"
        f'<div style="color:{DIM};font-size:.92em">{escape(names)}</div>'
        f"<div>{escape(capital(report.sentence))}</div>{volts}</div>"
    )


_LOOKS: dict[MotorLook, tuple[str, str]] = {
    "waiting": ("○", DIM),
    "now": ("●", _AMBER),
    "found": ("●", GOOD),
    "trouble": ("✗", BAD),
    "done": ("✓", GOOD),
    "skipped": ("–", DIM),
}


def motor(view: MotorView, *, state: MotorLook, words: str, fix: str) -> str:
    """The motor that is asked for: its state, its figures, what to do."""
    colour = _LOOKS[state][1]
    todo = f"<div><b>Do this:</b> {escape(capital(fix))}</div>" if fix else ""
    return (
        f'<div style="margin:.35em .8em;padding:.4em .55em;border:1px solid {colour};'
        'border-radius:.4em;font-size:.88em;line-height:1.4;overflow-wrap:anywhere">'
        f"{_motor_line(view, state)}<div>{escape(capital(words))}{todo}</div></div>"
    )


def motor_list(lines: Iterable[tuple[MotorView, MotorLook]]) -> str:
    """All motors, the first to be set up on top."""
    rows = "".join(_motor_line(view, state) for view, state in lines)
    return f'<div style="padding:.3em 1.3em;font-size:.85em;line-height:1.7">{rows}</div>'


def _motor_line(view: MotorView, state: MotorLook) -> str:
    mark, colour = _LOOKS[state]
    return (
        '<div style="display:grid;grid-template-columns:1.1em 1fr max-content;gap:.2em">'
        f'<b style="color:{colour}">{mark}</b><b>{escape(view.joint)}</b>'
        f'<span style="color:{DIM}">{escape(_identity(view, state))}</span></div>'
    )


def _identity(view: MotorView, state: MotorLook) -> str:
    """The id and the rate it has, and the id it is to have."""
    if state == "skipped":
        return "skipped"
    if view.found_id is None or state in ("now", "waiting"):
        return f"gets id {view.target_id}"
    rate = "" if view.baud is None else f", {_rate(view.baud)}"
    if state in ("found", "trouble") and view.found_id != view.target_id:
        return f"id {view.found_id} → {view.target_id}{rate}"
    return f"id {view.found_id}{rate}"


def _rate(baud: int) -> str:
    return f"{baud // 1_000_000} Mbaud" if baud >= 1_000_000 else f"{baud / 1000:g} kbaud"


def troubles(found: Verification) -> list[tuple[str, str]]:
    """What is wrong in the chain and what to do, grouped by what to do."""
    alike: dict[tuple[str, str], list[MotorCheck]] = {}
    for check in found.motors.values():
        if check.error:
            alike.setdefault((check.status, check.fix), []).append(check)
    problems = []
    for (_status, fix), (first, *others) in alike.items():
        ids = ", ".join(str(check.servo_id) for check in others)
        problems.append((f"{first.error}; the same with {ids}" if ids else first.error, fix))
    return problems


def grid(found: Verification) -> str:
    """The problems in the finished chain, then its six motors, base to jaw."""
    cells = []
    for check in found.motors.values():
        is_ok = check.status == "ok"
        colour, mark = (GOOD, "✓") if is_ok else (BAD, "✗")
        facts = check.facts
        about = "as it should be"
        if facts is not None:
            about = f"{facts.volts:.1f} V, firmware {facts.firmware}"
        about = about if is_ok else check.status.replace("_", " ")
        cells.append(
            f'<div style="border:1px solid {colour};border-radius:.4em;padding:.25em .45em">'
            f'<div><b style="color:{colour}">{mark}</b> <b>{check.servo_id}</b> '
            f'{escape(check.joint)}</div><div style="color:{DIM};font-size:.9em">'
            f"{escape(about)}</div></div>"
        )
    wrong = "".join(_marked("✗", BAD, *one) for one in troubles(found))
    return (
        f'{wrong}<div style="display:grid;grid-template-columns:1fr 1fr;gap:.35em;'
        f'padding:.3em .8em;font-size:.82em">{"".join(cells)}</div>'
    )
