"""Two emulated arms that follow targets into each other, with the referee on both wires.

The arms face each other at 350 mm, in one cell, each behind the real driver. Their servos are
emulated (fitted on recordings of one real servo), so the joints lag, droop and swing past a stop:
what counts here are the true poses of the joints, not the commands. Everything runs on a simulated
clock; the wire is answered at once, without a pseudo-terminal.
"""

from __future__ import annotations

import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np

from benchmarks import _common
from benchmarks.bench_cell import T_LEFT_RIGHT, Tasks
from benchmarks.solids import Solids
from so101_motion.arm.cell import Cell
from so101_motion.common.clock import ManualClock
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.control.following import Following
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.servo_types import STS3215_12V, ServoType
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.hardware_rig import HardwareRig, open_hardware
from so101_motion.rig.port_settings import ServoSettings

JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)
PHASE = 0.004
"""By how much the control cycles of the arms are apart [s]."""

JERK = 150.0
"""Cap of both followings [rad/s^3], as in ``bench_arms_apart.py``."""

CAPS = ((float(np.radians(50.0)), float(np.radians(100.0))), (float(np.pi), 8.0))
"""Speed [rad/s] and acceleration [rad/s^2]: those with which an arm is opened, and those of
``bench_arms_apart.py``."""

SEEDS = (1, 2, 3)

NEAREST, NEAREST_HULLS = "triangles nearest [mm]", "hulls nearest [mm]"
OFF, HELD = "joints off their setpoints, most [deg]", "held by the other"

_direct: Any = _common.from_tests("harness.direct_port")
_command: Any = _common.from_tests("referee.command")
_referee: Any = _common.from_tests("referee.official")


class EmulatedArm:
    """An emulated arm at ``q_start`` and its rig, with a referee that knows what it may do."""

    def __init__(
        self,
        name: str,
        clock: ManualClock,
        q_start: Array,
        caps: MotionLimits,
        kind: ServoType = STS3215_12V,
    ) -> None:
        self.emulator = Emulator(
            EmulatorOptions(q_start=(*q_start, 0.0), kind=kind),
            now=clock.now,
            gravity=RobotModel.load().gravity_torque,
            serve=lambda bus: _direct.Socket(bus, clock, clock.now),
        )
        self.rig: HardwareRig = open_hardware(
            ServoSettings(port=f"/dev/{name}", servo_ids=(1, 2, 3, 4, 5), gripper_id=6),
            clock=clock,
            open_port=_Opener(self.emulator),  # type: ignore
        )
        speed, acceleration, jerk = (
            float(np.degrees(each[0])) for each in (caps.velocity, caps.acceleration, caps.jerk)
        )
        one = _command.CommandCaps(speed, acceleration, jerk)
        jaw = _command.CommandCaps(90.0, np.degrees(10.0), np.degrees(600.0), braking=1376.0)
        match = _referee.match_of(self.emulator)
        match.ask_caps(lambda: (*(_referee.Caps(speed),) * 5, _referee.Caps(90.0, 1376.0)))
        self.rig.servos.on_command = match.listen(lambda: (*(one,) * 5, jaw), self._ticks)
        self.rig.executor.requests.on_request = match.requested

    def _ticks(self, i: int, q: float) -> float:
        joint = self.rig.servos.setups[JOINTS[i]].map
        return float(joint.zero_ticks + joint.direction * q * 4096.0 / (2.0 * np.pi))

    @property
    def q(self) -> Array:
        """True angles of the six joints, with the zero of the calibration [rad]."""
        self.emulator.advance()
        world = self.emulator.world
        true = np.array(world.q)
        for i, joint in enumerate(JOINTS):
            servo = world.servo(joint)
            off = self.rig.servos.setups[joint].map.zero_ticks - servo.joint.zero_ticks
            true[i] -= servo.joint.direction * off * 2.0 * np.pi / 4096.0
        return true

    def close(self) -> None:
        """Close rig and emulator."""
        self.rig.close()
        self.emulator.close()


class _Opener:
    """Opens an emulator's port at any rate; fits ``PortOpener``."""

    baud = 1_000_000

    def __init__(self, emulator: Emulator) -> None:
        self._socket: Any = emulator._port

    def __call__(self, baud: int | None = None) -> Any:
        return self._socket.open()


def emulated_followings(ticks: int) -> list[dict[str, Any]]:
    """Let two emulated arms follow targets for so many ticks in all; a row for each of ``CAPS``."""
    each, rows = ticks // (len(CAPS) * len(SEEDS)), []
    for velocity, acceleration in CAPS:
        speed = f"{np.degrees(velocity):.0f} deg/s"
        pieces = {
            f"emulated, {speed}, seed {seed}, {each} ticks": partial(
                followed, each, seed, velocity, acceleration
            )
            for seed in SEEDS
        }
        parts = _common.in_pieces("bench_arms_apart", pieces)
        rows.append({"what": f"two emulated guarded followings, up to {speed}", **_merged(parts)})
    return rows


def _merged(parts: list[dict[str, Any]]) -> dict[str, Any]:
    merge: dict[str, Any] = {NEAREST: min, NEAREST_HULLS: min, OFF: max, HELD: np.mean}
    keys = dict.fromkeys(key for part in parts for key in part)
    merged = {
        key: merge.get(key, sum)([part[key] for part in parts if key in part]) for key in keys
    }
    return {**merged, HELD: float(merged[HELD])}


def followed(ticks: int, seed: int, velocity: float, acceleration: float) -> dict[str, Any]:
    """Let both arms follow random targets for so many ticks.

    Args:
        ticks: Control cycles of both arms.
        seed: Of the leaders.
        velocity: Cap of the joints [rad/s].
        acceleration: Likewise [rad/s^2].
    """
    tasks, clock = Tasks(seed), ManualClock()
    caps = MotionLimits.uniform(velocity=velocity, acceleration=acceleration, jerk=JERK)
    solids = Solids(SE3.identity(), T_LEFT_RIGHT)
    objections: Counter[str] = Counter()
    touching = held = 0
    off, spent = 0.0, time.process_time()
    with ExitStack() as stack:
        referee = stack.enter_context(_referee.refereed(_referee.RULES))  # they are counted here
        report = referee.report

        def count(rule: str, t: float, place: int, text: str) -> None:
            objections[rule] += 1
            report(rule, t, place, text)

        referee.report = count
        arms: list[EmulatedArm] = []
        for name, q in zip(("left", "right"), tasks.draw()[0], strict=True):
            arm = EmulatedArm(name, clock, q, caps)
            stack.callback(arm.close)
            arms.append(arm)
            clock.advance(PHASE)
        clock.advance(1.0)  # their weight is taken up
        cell = Cell()
        for name, arm, T in zip(
            ("left", "right"), arms, (SE3.identity(), T_LEFT_RIGHT), strict=True
        ):
            cell.add(name, arm.rig, T)
        followings = [opened(arm, clock, caps) for arm in arms]
        left_for = [0, 0]
        for _ in range(ticks):
            for k, following in enumerate(followings):
                if left_for[k] == 0:
                    following.aim(tasks.near())
                    left_for[k] = int(tasks.random.integers(10, 120))
                left_for[k] -= 1
                held += any("'s " in each for each in following.held_by)
            clock.advance(0.01)
            true = [arm.q for arm in arms]
            touching += solids.touch(*true)
            solids.measure(*true)
            apart = (arm.rig.arm.state.q_ref - q[:5] for arm, q in zip(arms, true, strict=True))
            off = max(off, *(float(np.abs(each).max()) for each in apart))
        ended = sum(following.future.done() for following in followings)
        for following in followings:
            following.close()
        clock.advance(3.0)
        judged = referee.seen
    for finding in referee.findings[:20]:
        print(finding)
    return {
        "ticks": ticks,
        "touching": touching,
        NEAREST_HULLS: 1e3 * solids.nearest_hulls,
        NEAREST: 1e3 * solids.nearest_triangles,
        OFF: float(np.degrees(off)),
        HELD: held / (2 * ticks),
        "followings that ended": ended,
        "judged by the referee": judged,
        "objections": sum(objections.values()),
        **{f"objections: {rule}": number for rule, number in sorted(objections.items())},
        "processor time [s]": time.process_time() - spent,
    }


def opened(arm: EmulatedArm, clock: ManualClock, caps: MotionLimits, **settings: Any) -> Following:
    """A following of this arm; the clock goes on until it is open."""
    how = partial(arm.rig.arm.follow, limits=caps, stale_after=None, gate=10.0, **settings)
    with ThreadPoolExecutor(1) as threads:
        done = threads.submit(how)
        while not done.done():
            clock.advance(0.01)
    return done.result()
