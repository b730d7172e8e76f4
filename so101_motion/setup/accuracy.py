"""Compute how well each joint followed its goals in a move test, and the verdict.

For each joint: its error at rest, how much that depends on the side it came from (friction, dead
band and play of the gears together; one encoder cannot tell them apart), its lag while it moves,
and how long it takes to settle. Nothing here moves anything; ``move_test`` does.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from so101_motion.common.state import GRIPPER_JOINT, JointState
from so101_motion.common.units import to_deg, to_mm, to_rad

Verdict = Literal["ok", "warn", "fail", "not tested"]

SCHEMA = "so101/move-test/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Above ``warn`` there is a warning, above ``fail`` a failure."""

    warn: float
    fail: float

    def judge(self, value: float | None) -> Verdict:
        if value is None or value <= self.warn:
            return "ok"
        return "warn" if value <= self.fail else "fail"


ERROR = Bounds(warn=to_rad(0.5), fail=to_rad(1.5))
"""At rest [rad]. The driver trims a joint to a quarter of a degree; 1.5 deg are 8 mm at full
stretch. Chosen."""

JAW_ERROR = Bounds(warn=to_rad(2.5), fail=to_rad(6.0))
"""The same for the jaw, whose standing error nobody corrects. Chosen."""

HYSTERESIS = Bounds(warn=to_rad(0.6), fail=to_rad(1.5))
"""Between the two sides [rad]: a trimmed joint may stop at either end of the trim's dead band.
Chosen."""

LAG = Bounds(warn=0.15, fail=0.30)
"""While it moves [s]. Servos were seen up to 0.1 s behind. Chosen."""

SETTLE = Bounds(warn=1.0, fail=2.0)
"""After the end of a motion [s]; the driver gives up after 2 s. Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointAccuracy:
    """How well one joint followed its goals.

    Attributes:
        hysteresis: How much that differs with the side it came from [rad]; None if not known.
        settle: How long it took at most to come to rest [s]; None if setpoints are not known.
        tool: Largest error of the tool through all joints together [m]; None for the jaw.
    """

    joint: str
    error: float | None = None  # largest error at rest [rad]; None if it never came to rest
    hysteresis: float | None = None
    lag: float | None = None  # how far behind its setpoints it ran [s]; None if those are not known
    settle: float | None = None
    tool: float | None = None
    trouble: str = ""  # why it could not be tested to the end; empty if it was

    @property
    def verdict(self) -> Verdict:
        if self.error is None:
            return "fail" if self.trouble else "not tested"
        return "fail" if self.trouble else _worst(verdict for verdict, _ in self._findings())

    @property
    def sentence(self) -> str:
        if self.trouble:
            return self.trouble
        return "; ".join(sentence for verdict, sentence in self._findings() if verdict != "ok")

    def _findings(self) -> list[tuple[Verdict, str]]:
        error = JAW_ERROR if self.joint == GRIPPER_JOINT else ERROR
        return [
            (error.judge(self.error), "it stops short: free the joint, look for weight or a cable"),
            (HYSTERESIS.judge(self.hysteresis), "it sticks or has play: check its horn and screws"),
            (LAG.judge(self.lag), "it lags: check the supply and its voltage"),
            (SETTLE.judge(self.settle), "it settles slowly: something holds it back"),
        ]

    def to_json(self) -> dict[str, Any]:
        return {
            "joint": self.joint,
            "verdict": self.verdict,
            "error_deg": _deg(self.error),
            "hysteresis_deg": _deg(self.hysteresis),
            "lag_ms": None if self.lag is None else _rounded(1e3 * self.lag),
            "settle_ms": None if self.settle is None else _rounded(1e3 * self.settle),
            "tool_mm": None if self.tool is None else _rounded(to_mm(self.tool)),
            "sentence": self.sentence,
        }


def reasons(joints: Iterable[JointAccuracy]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for joint in joints:
        if joint.sentence:
            found.setdefault(joint.sentence, []).append(joint.joint)
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveReport:
    """The result of a move test.

    Attributes:
        as_shown: Whether the user saw the arm move as its picture did, which no encoder can tell;
            None without an answer.
    """

    arm: str
    joints: tuple[JointAccuracy, ...]
    began_at: str  # its begin, as an ISO date and time with its zone
    seconds: float  # how long it took [s]
    ended_by: str = ""  # why it ended early; empty if it did not
    as_shown: bool | None = None

    @property
    def passed(self) -> bool:
        fit = all(joint.verdict in ("ok", "warn") for joint in self.joints)
        return fit and not self.ended_by and self.as_shown is not False

    @property
    def sentence(self) -> str:
        if self.ended_by:
            return f"The test was not finished: {self.ended_by}"
        if self.as_shown is False:
            return (
                "Failed: the arm does not move as in the picture. Two motors may be swapped: set"
                " the motors up again, then calibrate"
            )
        bad = [joint.joint for joint in self.joints if joint.verdict not in ("ok", "warn")]
        if bad:
            return f"Failed: {', '.join(bad)}"
        warned = [joint.joint for joint in self.joints if joint.verdict == "warn"]
        return (
            f"Passed, but look at {', '.join(warned)}"
            if warned
            else "Passed: all joints move as commanded"
        )

    @property
    def verdict(self) -> Literal["ok", "warn", "fail"]:
        if not self.passed:
            return "fail"
        return "warn" if any(joint.verdict == "warn" for joint in self.joints) else "ok"

    @property
    def fix(self) -> str:
        if self.passed:
            return ""
        return "test again" if self.ended_by else "read the note at each joint, then test again"

    @property
    def tool(self) -> float | None:
        """How far the tool was off at most [m]; None if that was not measured."""
        return max((j.tool for j in self.joints if j.tool is not None), default=None)

    def to_json(self) -> dict[str, Any]:
        return {
            "arm": self.arm,
            "began_at": self.began_at,
            "seconds": _rounded(self.seconds),
            "passed": self.passed,
            "sentence": self.sentence,
            "as_shown": self.as_shown,
            "tool_mm": None if self.tool is None else _rounded(to_mm(self.tool)),
            "joints": [joint.to_json() for joint in self.joints],
        }

    def file(self, versions: Mapping[str, str] | None = None) -> bytes:
        content = {"schema": SCHEMA, **(versions or {}), **self.to_json()}
        return json.dumps(content, indent=2).encode() + b"\n"

    def text(self) -> str:
        lines = [
            f"{self.sentence}.",
            f"{self.arm}, {self.began_at}, {self.seconds:.0f} s",
            "",
            f"{'':12}{'joint':<15}{'off':>8}{'sides':>8}{'behind':>9}{'settles':>9}{'tool':>9}",
        ]
        lines += [
            f"{joint.verdict:<12}{joint.joint:<15}{degrees(joint.error):>8}"
            f"{degrees(joint.hysteresis):>8}{milliseconds(joint.lag):>9}"
            f"{milliseconds(joint.settle):>9}{millimetres(joint.tool):>9}"
            for joint in self.joints
        ]
        wrong = [f"{', '.join(same)}: {why}." for why, same in reasons(self.joints).items()]
        return "\n".join([*lines, *([""] if wrong else []), *wrong]) + "\n"


class Measurements:
    """The measurements of one joint so far."""

    def __init__(self, joint: str) -> None:
        self._joint = joint
        self.tool = self._settle = 0.0
        self._error: float | None = None
        self._behind: list[tuple[float, float]] = []  # (error, speed) while it moved
        self._visits: dict[float, dict[bool, list[float]]] = {}  # place: from below: angles

    def note_motion(self, i: int, states: list[JointState]) -> None:
        moving = [state for state in states if state.arm_moving]
        moving_refs = [state for state in moving if state.qd_ref[i] != 0.0]
        self._behind += [(float(s.q_ref[i] - s.q[i]), float(s.qd_ref[i])) for s in moving_refs]
        if moving_refs:
            self._settle = max(self._settle, moving[-1].t - moving_refs[-1].t)

    def note_stop(self, wanted: float, here: float, *, is_from_below: bool) -> None:
        self._error = max(self._error or 0.0, abs(here - wanted))
        visits = self._visits.setdefault(round(wanted, 4), {False: [], True: []})
        visits[is_from_below].append(here)

    def note_jaw(self, off: float) -> None:
        self._error = max(self._error or 0.0, abs(off))

    def accuracy(self) -> JointAccuracy:
        lag, is_jaw = self._lag(), self._joint == GRIPPER_JOINT
        return JointAccuracy(
            joint=self._joint,
            error=self._error,
            hysteresis=self._hysteresis(),
            lag=lag,
            settle=None if lag is None else self._settle,
            tool=None if is_jaw or self._error is None else self.tool,
        )

    def _hysteresis(self) -> float | None:
        """The most that two stops in one place differ with the side they were reached from."""
        apart = [
            abs(float(np.mean(sides[True])) - float(np.mean(sides[False])))
            for sides in self._visits.values()
            if sides[True] and sides[False]
        ]
        return max(apart, default=None)

    def _lag(self) -> float | None:
        """How late the joint is [s], by least squares.

        To first order a joint that is late by ``lag`` is off by ``lag`` times its speed. None where
        the arm does not tell setpoints apart from measurements.
        """
        pairs = np.array(self._behind).reshape(-1, 2)
        error, speed = pairs[:, 0], pairs[:, 1]
        if not np.any(error):
            return None
        return max(float(error @ speed / (speed @ speed)), 0.0)


def degrees(angle: float | None) -> str:
    return "–" if angle is None else f"{to_deg(angle):.1f}°"


def milliseconds(duration: float | None) -> str:
    return "–" if duration is None else f"{1e3 * duration:.0f} ms"


def millimetres(length: float | None) -> str:
    return "–" if length is None else f"{to_mm(length):.1f} mm"


_RANK: tuple[Verdict, ...] = ("ok", "warn", "fail")


def _worst(verdicts: Any) -> Verdict:
    return max(verdicts, key=_RANK.index)


def _deg(angle: float | None) -> float | None:
    return None if angle is None else _rounded(to_deg(angle), 3)


def _rounded(value: float, digits: int = 1) -> float:
    return round(float(value), digits) + 0.0
