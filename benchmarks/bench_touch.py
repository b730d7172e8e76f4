"""Accuracy of ``so101 cell calibrate`` on emulated arms that emulated hands lead to touches.

Two emulated arms whose servos differ (spread 0.2: friction, play, torque, dead time, zero) stand
somewhere beside each other. Each has been calibrated from stop to stop, up to half a degree wrong
at every stop. Then the command runs: both arms yield, hands lead them until the tips of the fixed
jaws touch, as near as hands do it, and go on to the next place. The hands are springs of limited
pull that see where the tips really are. Contacts of other parts are not checked.

Drawn are the arrangements, the arms, the errors of their calibration and the places of the touches.
What was found is held against where the base really stands, and where it takes the tip at the
touches. The servos are emulated: fitted on recordings of one real servo.

    python -m benchmarks.bench_touch --arrangements 20
"""

from __future__ import annotations

import argparse
import math
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from so101_motion.calib.record import store, zero
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import CalibrationError, Unreachable
from so101_motion.common.geometry import SE3, Array, rotation_angle
from so101_motion.drivers.emulator.hand import Hand, Waypoint
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.setup.base_fit import TIP, measure_bases

SPREAD_OF_SERVOS = 0.2
MISSED = math.radians(0.5)
"""How much of the travel a calibration misses at each stop at most [rad]; chosen."""

BY_HAND = 0.0015
"""Hands stop correcting when the tips are this near to each other [m]; chosen."""

TRIES = 8
"""How often hands correct a touch at most."""

TICKS_PER_RAD = 4096.0 / math.tau

_rig: Any = _common.from_tests("harness.emulated_rig")
_referee: Any = _common.from_tests("referee.official")


def calibrated(joints: list[Any], file: Path, random: np.random.Generator) -> Path:
    """A calibration from stop to stop of emulated joints, with its errors."""
    calibration: dict[str, JointCalibration] = {}
    zeros: dict[str, Any] = {}
    for number, joint in enumerate(joints, 1):
        missed = random.uniform(0.0, MISSED, 2)
        lower = joint.zero_ticks + (joint.lower + missed[0]) * TICKS_PER_RAD
        upper = joint.zero_ticks + (joint.upper - missed[1]) * TICKS_PER_RAD
        offset = (round((lower + upper) / 2) + 1) % 4096 - 2048
        middle = (round((lower + upper) / 2) - offset) % 4096
        entry = JointCalibration(
            id=number,
            homing_offset=offset,
            range_min=round(middle - (upper - lower) / 2),
            range_max=round(middle + (upper - lower) / 2),
            norm_mode=1 if joint.name == "gripper" else 3,
        )
        calibration[joint.name] = entry
        if joint.name in zero.SWEPT:
            zeros[joint.name] = zero.by_stops(joint.name, entry)
        elif joint.name == "wrist_roll":
            angle = zero.ROLL_UPRIGHT + random.uniform(-MISSED, MISSED)
            upright = joint.zero_ticks + angle * TICKS_PER_RAD - offset
            zeros[joint.name] = zero.by_pose(entry, round(upright) % 4096, angle=zero.ROLL_UPRIGHT)
    store.save(file, calibration, zeros=zeros)
    return file


class Pair:
    """Two emulated arms, and hands that lead them."""

    def __init__(self, stack: ExitStack, folder: Path, seed: int) -> None:
        self.random, self.clock = np.random.default_rng(seed), ManualClock()
        model = RobotModel.load()
        T_tool_jaw_tip = model.frame(np.zeros(5)).inverse @ model.frame(np.zeros(5), "jaw_tip")
        T_tool_tip = T_tool_jaw_tip @ SE3.from_translation((0.0, 0.0, TIP))
        self._model = model.with_frame("tip", T_tool_tip)
        self._ik = IkSolver(self._model)
        self.benches: dict[str, Any] = {}
        self.arms: dict[str, Any] = {}
        for k, name in enumerate(("left", "right")):
            (folder / name).mkdir()
            bench = stack.enter_context(
                _rig.hardware_bench(
                    folder / name, clock=self.clock, reply_timeout=2.0, is_heard=False,
                    calibrated=False, spread=SPREAD_OF_SERVOS, seed=2 * seed + k,
                )
            )  # fmt: skip
            joints = [bench.world.servo(joint).joint for joint in JOINTS]
            file = calibrated(joints, folder / name / "arm.json", self.random)
            self.benches[name], self.arms[name] = bench, bench.open(calibration_file=file).arm
        self.clock.advance(1.0)
        self.T = self._arrangement()
        self.places: list[tuple[Array, Array]] = []
        self.gaps: list[float] = []

    def _arrangement(self) -> SE3:
        """True pose of the right arm's base: somewhere opposite, a little tilted."""
        x, y, z = self.random.uniform((0.28, -0.06, -0.02), (0.42, 0.06, 0.02))
        tilts = self.random.uniform(-1.0, 1.0, 2) * math.radians(2.0)
        yaw = math.pi + self.random.uniform(-0.5, 0.5)
        return SE3.from_rpy((*tilts, yaw), (x, y, z))

    def place(self) -> tuple[Array, Array]:
        """Joint angles of both at which the tips are at one drawn place, shape (5,) each, [rad]."""
        while True:
            p = self.random.uniform((0.08, -0.12, 0.04), (self.T.p[0] - 0.08, 0.12, 0.24))
            goals = (PoseGoal.at_point(each, frame="tip") for each in (p, self.T.inverse @ p))
            with suppress(Unreachable):
                q_left, q_right = (self._ik.solve(goal, np.zeros(5)).q for goal in goals)
                return q_left, q_right

    def tips(self) -> tuple[Array, Array]:
        """Where the tips really are in the left arm's base frame, shape (3,) each, [m]."""
        q = [np.radians(bench.q_deg[:5]) for bench in self.benches.values()]
        left, right = (self._model.frame(each, "tip").p for each in q)
        return left, self.T @ right

    def lead(self, q: tuple[Array, Array], seconds: float) -> None:
        """Hands lead both arms softly to joint angles, and hold them there."""
        for bench, goal in zip(self.benches.values(), q, strict=True):
            here = np.radians(bench.q_deg[:5])
            script = [Waypoint(t=0.0, joint=joint) for joint in JOINTS[:5]]
            for t in np.linspace(0.0, 1.0, max(2, round(seconds / 0.02)))[1:]:
                now = here + (goal - here) * t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
                script += [
                    Waypoint(t=t * seconds, joint=joint, q=float(each))
                    for joint, each in zip(JOINTS[:5], now, strict=True)
                ]
            bench.world.hand = Hand(sorted(script, key=lambda each: each.t), bench.world.t)
        self.clock.wait(self.clock.now() + seconds + 0.5, threading.Event())

    def touch(self, *_: object) -> None:
        """Hands let the tips touch at a drawn place; what they do takes simulated time."""
        with self.clock.attend():
            q = goal = self.place()
            self.lead(goal, 3.0)
            for _try in range(TRIES):
                there = self.tips()
                if float(np.linalg.norm(there[0] - there[1])) < BY_HAND:
                    break
                seen = [np.radians(each.q_deg[:5]) for each in self.benches.values()]
                left, right = (g + a - b for g, a, b in zip(goal, q, seen, strict=True))
                goal = left, right
                self.lead(goal, 0.5)
            there = self.tips()
            self.places.append(there)
            self.gaps.append(float(np.linalg.norm(there[0] - there[1])))


def found(seed: int, touches: int) -> dict[str, Any]:
    """Errors of the bases found in one arrangement."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        stack.enter_context(_referee.refereed(("motion",)))
        pair = Pair(stack, folder, seed)
        with ThreadPoolExecutor(1) as pool:
            done = pool.submit(measure_bases, pair.arms, touches, pair.touch)
            while not wait([done], timeout=0.0005).done:
                pair.clock.advance(0.01)
        try:
            fit = done.result()["right"]
        except CalibrationError as error:
            return {"refused": str(error), "gaps": pair.gaps}
        off = pair.T.inverse @ fit.T_first_second
        taken = [fit.T_first_second @ (pair.T.inverse @ right) - right for _, right in pair.places]
        return {
            "gaps": pair.gaps,
            "rms": fit.rms,
            "worst": float(fit.residuals.max()),
            "base": float(np.linalg.norm(off.p)),
            "turned": rotation_angle(off.R),
            "tips": [float(np.linalg.norm(each)) for each in taken],
        }


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arrangements", type=int, default=20)
    asked = parser.parse_args()
    rows = [row(6, asked.arrangements), row(10, asked.arrangements // 2)]
    _common.write("bench_touch", rows)


def row(touches: int, arrangements: int) -> dict[str, Any]:
    """A row of the results."""
    pieces = {f"{touches}: {seed}": partial(found, seed, touches) for seed in range(arrangements)}
    all_of = _common.in_pieces("bench_touch", pieces)
    fits = [each for each in all_of if "refused" not in each]

    def said(key: str, scale: float, of: list[dict[str, Any]] = fits) -> str:
        values = scale * np.concatenate([np.atleast_1d(each[key]) for each in of])
        return f"{np.median(values):.2f}, {values.max():.2f}"

    return {
        "what": f"{touches} touches, {arrangements} arrangements; median, worst",
        "refused": len(all_of) - len(fits),
        "tips apart at a touch [mm]": said("gaps", 1e3, all_of),
        "residual, rms [mm]": said("rms", 1e3),
        "residual, largest [mm]": said("worst", 1e3),
        "base off [mm]": said("base", 1e3),
        "base turned [deg]": said("turned", math.degrees(1.0)),
        "tip off at the touches [mm]": said("tips", 1e3),
    }


if __name__ == "__main__":
    main()
