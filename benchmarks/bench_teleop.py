"""Teleoperation: latency, tracking error, lost connections, and half an hour with lost replies.

Two emulated arms with weight, friction and play; rigs, drivers, bus and session are the real ones.
Most of it runs on one clock that drives all, so the machine's speed does not matter; angles are the
joints' true ones there. The last part runs in real time, each emulator in a process of its own with
the time of the wire at 1 Mbaud and an adapter that holds replies back for 1 ms; angles are what the
servos report, stamped when each cycle began.

The motion imitates a person's: reaches of minimum jerk, 30 to 120 deg/s and 150 to
350 deg/s^2, all joints at their own times, with pauses and 0.08 deg of tremor at 6 to 10 Hz.

*Latency* is a shift in time. Over all: the one shift of all joints that leaves the least between
leader and follower, root mean square; what it leaves is the tracking error, offsets included. In
stretches of 2 s (and of 1 s): the shift that leaves the least variance, for each joint that moves
by 10 deg or more in that stretch; of those the median and the 99th percentile. Friction and play
are in it: a joint that turns round slowly sticks for some hundredths of a second first.

``--before COMMIT`` compares with the teleoperation of an older commit, all of its code but the
emulator, which is today's: the same servos, leader and clock. The leader moves at up to 120 deg/s,
then at up to 180, which its accelerations leave no way for, then pan and roll to and fro at 180;
all clear of the table. Today's follower has its guard first and then none. How hard a servo truly
brakes is not judged there. It runs nothing else.

``--minutes`` says how long the long run is, 30 by default. It takes a fifth of that, and runs
beside the other parts on that clock; all together need two processors for eight minutes.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from benchmarks._machine import memory
from benchmarks.emulated_port import SUPPORT, emulated_port
from so101_motion.common.clock import ManualClock
from so101_motion.common.geometry import Array
from so101_motion.common.state import JointState
from so101_motion.control.following import Following
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.differential.guard import Guard
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.rig.rig import HARD_STOP
from so101_motion.tasks.teleop import LocalArm, LocalFollower, LocalLeader, Recorder, Teleop
from so101_motion.tasks.teleop.pilot import Pace

SECONDS = 60.0
SEEDS = (1, 2, 3)
FASTEST = (120.0, 180.0)
RAISED = np.array([0.0, -25.0, -20.0, 0.0, 0.0, 0.0])
"""What lifts the person's motion [deg], which touches the table otherwise: a follower with a guard
would not go along. Nothing is nearer than 50 mm then."""
PERIOD = 0.01

_bench: Any = _common.from_tests("harness.emulated_pair")
_referee: Any = _common.from_tests("referee.official")


# On one clock


IMPATIENT = 0.03
"""For how long a run with lost replies waits for each, on the wall clock [s]; a machine that has
something else to do meanwhile needs more."""


@contextmanager
def session(*, reply_timeout: float = 2.0, clock: Any = None, **options: Any) -> Iterator[Any]:
    """Two arms, started, in the middle of mirroring."""
    with (
        # Setpoints that leave late are no smooth command; what the joints make of them is judged.
        _referee.refereed(() if clock is None else ("command",)),
        tempfile.TemporaryDirectory() as folder,
        _bench.teleop_bench(Path(folder), reply_timeout=reply_timeout, clock=clock) as bench,
    ):
        bench.start(**options)
        bench.advance(0.5)
        yield bench


def mirrored(seed: int, seconds: float, **options: Any) -> tuple[Array, Array, Array]:
    """True angles of leader and follower, shape (n, 6), and what the follower was sent."""
    with session(**options) as bench:
        bench.leader.lead(_bench.human_motion(seconds + 1.5, seed))
        bench.advance(1.5)
        begin, rows = len(bench.goals), []
        for _ in range(round(seconds / PERIOD)):
            bench.clock.advance(PERIOD)
            rows.append((bench.leader.q_deg, bench.follower.q_deg))
        leader, follower = (np.array(side) for side in zip(*rows, strict=True))
        return leader, follower, np.degrees(np.array(bench.goals[begin:])[:, 1:6])


def figures(leader: Array, follower: Array, dt: float) -> dict[str, float]:
    """Latency and tracking of the five joints of the arm."""
    shift, error = _bench.best_shift(leader[:, :5], follower[:, :5], dt)
    found: dict[str, float] = {"shift [s]": shift, "rms after it [deg]": error}
    for window in (2.0, 1.0):
        each = _bench.shifts(leader[:, :5], follower[:, :5], dt, window=window)
        found[f"{window:g} s: n"] = len(each)
        found[f"{window:g} s: median"] = float(np.median(each))
        found[f"{window:g} s: p99"] = float(np.percentile(each, 99.0))
    return found


def following() -> Iterator[dict[str, Any]]:
    """Latency and tracking."""
    sides = [mirrored(seed, SECONDS) for seed in SEEDS]
    leader, follower = (np.vstack([side[i] for side in sides]) for i in (0, 1))
    qdd = [np.diff(side[2], n=2, axis=0) / PERIOD**2 for side in sides]
    yield {
        "what": "following a person",
        **figures(leader, follower, PERIOD),
        "acceleration [deg/s^2]": max(float(np.abs(each).max()) for each in qdd),
        "jerk [rad/s^3]": max(
            float(np.radians(np.abs(np.diff(each, axis=0))).max()) / PERIOD for each in qdd
        ),
    }


class BusyClock(ManualClock):
    """The clock of a machine that wakes threads that talk to servos 10 to 60 ms late, 1 % of times.

    Attributes:
        is_busy: Whether it does so now.
    """

    def __init__(self) -> None:
        super().__init__()
        self.is_busy, self._random = False, random.Random(1)

    def wait(self, until: float, wake: threading.Event | None) -> None:
        """Wait for the time or the event, sometimes for longer."""
        is_driving = threading.current_thread().name.startswith("so101-io")
        if self.is_busy and is_driving and self._random.random() < 0.01:
            until += self._random.uniform(0.01, 0.06)
        super().wait(until, wake)


def following_late() -> Iterator[dict[str, Any]]:
    """The same while one cycle in a hundred of either arm comes 10 to 60 ms late."""
    clock = BusyClock()
    with session(clock=clock) as bench:
        bench.leader.lead(_bench.human_motion(SECONDS + 1.5, SEEDS[0]) + RAISED)
        bench.advance(1.5)
        clock.is_busy, rows = True, []
        for _ in range(round(SECONDS / PERIOD)):
            bench.advance(PERIOD)
            rows.append((bench.leader.q_deg, bench.follower.q_deg))
        clock.is_busy = False
        leader, follower = (np.array(side) for side in zip(*rows, strict=True))
        yield {
            "what": "following a person, 1 % of the cycles 10 to 60 ms late",
            **figures(leader, follower, PERIOD),
            "ended": bench.teleop.status.phase.value,
            "late ticks": bench.follower.rig.arm.state.late_ticks,
        }


def to_and_fro(seconds: float, seed: int) -> Array:
    """Reaches of pan and roll at 180 deg/s and 350 deg/s^2, as long as they then must be.

    Returns:
        Angles, shape (n, 6), [deg], a row each ``PERIOD``; the other joints tremble only.
    """
    rng, far, duration = np.random.default_rng(seed), 152.0, 1.583
    t = np.arange(0.0, seconds, PERIOD)
    angles = np.zeros((len(t), 6))
    angles[:, 5] = 20.0
    for i in (0, 4):
        now, here = 0.3, 0.0
        while now < seconds:
            goal = 0.5 * far if here <= 0.0 else -0.5 * far
            takes = duration if here else duration * 0.5**0.5
            u = np.clip((t - now) / takes, 0.0, 1.0)
            step = (goal - here) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
            angles[:, i] += np.where(t >= now, step, 0.0)
            here, now = goal, now + takes + rng.uniform(0.0, 0.6)
    tremble = np.sin(2.0 * np.pi * rng.uniform(6.0, 10.0, 6) * t[:, None])
    trembling: Array = angles + 0.08 * np.minimum(t, 1.0)[:, None] * tremble
    return trembling


def compared(commit: str) -> Iterator[dict[str, Any]]:
    """Today's latency and tracking, and an older commit's with the same servos and leader."""
    here = Path(__file__).parents[1]
    with tempfile.TemporaryDirectory() as name:
        old = Path(name)
        tree = subprocess.run(["git", "archive", commit], cwd=here, check=True, capture_output=True)
        subprocess.run(["tar", "x"], cwd=old, input=tree.stdout, check=True)
        for part in ("emulator", "servo_types.py"):
            target = old / "so101_motion" / "drivers" / part
            if target.is_dir():
                shutil.rmtree(target)
            copy = shutil.copytree if part == "emulator" else shutil.copy
            copy(here / "so101_motion" / "drivers" / part, target)
        person = [partial(_bench.human_motion, fastest=fastest) for fastest in FASTEST]
        motions_of: list[Callable[[float, int], Array]] = [*person, to_and_fro]
        for leads in motions_of:
            ways = old / "ways.npy"
            motions = [leads(SECONDS + 1.5, seed) + RAISED for seed in SEEDS]
            np.save(ways, motions)
            speed = float(np.abs(np.diff(motions, axis=1)).max()) / PERIOD
            for who, checkout, options in (
                ("today, guarded", here, {"guarded": True}),
                ("today, unguarded", here, {}),
                (f"the teleoperation of {commit}", old, {}),
            ):
                found = _followed(checkout, ways, options)
                yield {"what": who, "leader at up to [deg/s]": speed, **found}


def _followed(checkout: Path, ways: Path, options: dict[str, bool]) -> dict[str, float]:
    program = (
        "import json, numpy as np; from benchmarks import bench_teleop as bench;"
        f"ways = iter(np.load({str(ways)!r}));"
        "bench._bench.human_motion = lambda seconds, seed: next(ways);"
        "refereed = bench._referee.refereed;"
        "bench._referee.refereed = lambda: refereed(('motion',));"
        f"sides = [bench.mirrored(seed, bench.SECONDS, **{options!r}) for seed in bench.SEEDS];"
        "both = (np.vstack([side[i] for side in sides]) for i in (0, 1));"
        "print(json.dumps(bench.figures(*both, bench.PERIOD)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=checkout, check=True, stdout=subprocess.PIPE, text=True
    )
    found: dict[str, float] = json.loads(done.stdout)
    return found


def losing() -> Iterator[dict[str, Any]]:
    """From the loss of a side in full motion to the first slower setpoint, and to rest."""
    cases: dict[str, Any] = {
        "leader unplugged": lambda bench: bench.leader.emulator.unplug(),
        "leader silent": lambda bench: [bench.leader.world.disconnect(i) for i in range(1, 7)],
        "follower unplugged": lambda bench: bench.follower.emulator.unplug(),
    }
    t = np.arange(0.0, 4.0, PERIOD)
    for name, lose in cases.items():
        with session(reply_timeout=IMPATIENT) as bench:
            way = np.tile(np.degrees(bench.leader.world.q), (len(t), 1))
            way[:, 0] += 40.0 * np.sin(0.5 * np.pi * t)  # 63 deg/s in the middle
            bench.leader.lead(way)
            bench.advance(2.2)
            lose(bench)
            begin, speeds = bench.clock.now(), []
            before = bench.follower.q_deg[0]
            for _ in range(100):
                bench.advance(PERIOD)
                speeds.append(abs(bench.follower.q_deg[0] - before) / PERIOD)
                before = bench.follower.q_deg[0]
            rest = next(k for k in range(100) if max(speeds[k:]) < 4.0 or k == 99)
            slower = next(k for k in range(100) if max(speeds[k:]) < 0.9 * speeds[0])
            sent = np.array([row[:2] for row in bench.goals if row[0] >= begin])
            rates = np.abs(np.diff(np.degrees(sent[:, 1])) / np.diff(sent[:, 0]))
            braked = next((k for k in range(len(rates)) if rates[k] < 0.97 * rates[0]), None)
            yield {
                "what": name,
                "speed [deg/s]": speeds[0],
                "slower setpoints after [s]": "none" if braked is None else PERIOD * braked,
                "slower by a tenth after [s]": PERIOD * slower,
                "at rest after [s]": PERIOD * rest,
            }


def costing() -> Iterator[dict[str, Any]]:
    """Time that following costs the follower's I/O thread in each period."""
    model = RobotModel.load()
    way = np.radians(_bench.human_motion(60.0, SEEDS[0])[:, :5])
    for name in ("a setpoint", "a setpoint, guarded"):
        guard = Guard(CollisionModel(model), lambda: 0.3, acceleration=HARD_STOP.acceleration)
        following = Following(
            q_start=way[0],
            lower=model.lower,
            upper=model.upper,
            limits=Pace().full,
            stop_limits=HARD_STOP,
            dt=PERIOD,
            guard=guard if "guarded" in name else None,
            each=partial(_aim, iter(way)),
        )
        _, times = _common.measure(lambda each: each.sample(0), [following] * len(way))
        yield {"what": name, **_common.summary(times)}


def _aim(targets: Iterator[Array], following: Following) -> None:
    following.aim(next(targets))


def lasting(minutes: float) -> dict[str, Any]:
    """A long run with one reply in a hundred lost on both wires."""
    gc.collect()
    with (
        _referee.refereed(("motion",)) as referee,
        tempfile.TemporaryDirectory() as folder,
        _bench.teleop_bench(Path(folder), reply_timeout=IMPATIENT) as bench,
    ):
        recorder = Recorder(Path(folder) / "long.mcap", fps=30.0)
        bench.start(recorder=recorder)
        bench.advance(0.5)
        for arm in (bench.leader, bench.follower):
            arm.emulator.bus.faults.loss = 0.01
        steps, used, lost, begin = [], [], 0, time.monotonic()
        for minute in range(round(minutes)):
            bench.goals.clear()
            bench.leader.lead(_bench.human_motion(60.0, 100 + minute))
            bench.advance(60.0)
            q = np.degrees(np.array(bench.goals)[:, 1:6])
            steps.append(float(np.abs(np.diff(q, axis=0)).max()))
            used.append(memory(os.getpid()) / 1e6)
            lost = sum(joint.lost for joint in bench.follower.rig.servos.health)
            phase, passed = bench.teleop.status.phase.value, time.monotonic() - begin
            print(f"minute {minute + 1}: {phase}, after {passed:.0f} s", flush=True)
        status = bench.teleop.status
        for arm in (bench.leader, bench.follower):
            arm.emulator.bus.faults.loss = 0.0
    return {
        "what": f"{minutes:g} min, 1 % of the replies lost",
        "ended": status.phase.value,
        "last error": status.last_error or "none",
        "replies lost by the follower": lost,
        "largest step [deg]": max(steps),
        "cap [deg]": 180.0 * PERIOD,
        "objections to the motion": "; ".join(map(str, referee.findings)) or "none",
        "memory after 2 min [MB]": used[min(1, len(used) - 1)],
        "memory at the end [MB]": used[-1],
        "rows recorded": recorder.rows,
        "rows lost": recorder.lost,
        "processor time [s]": time.process_time(),
    }


# In real time


def live(seconds: float) -> dict[str, Any]:
    """The same with processes, wires and the wall clock; the angles are what the servos say."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        ports = [
            stack.enter_context(emulated_port("--latency", "0.001", hand=hand))
            for hand in (_script(seconds + 14.0), SUPPORT)
        ]
        leader, follower = (
            stack.enter_context(open_hardware(ServoSettings(port=port, servo_ids=(1, 2, 3, 4, 5))))
            for port in ports
        )
        time.sleep(4.0)
        tapes: tuple[list[Any], list[Any]] = ([], [])
        teleop = stack.enter_context(
            Teleop(
                LocalLeader(LocalArm(station=leader, jaw=leader)),
                LocalFollower(LocalArm(station=follower, jaw=follower)),
                follower.clock,
            )
        )
        recorder = Recorder(folder / "live.mcap")
        teleop.start(recorder)
        time.sleep(6.0)
        late = follower.arm.state.late_ticks
        for rig, tape in ((leader, tapes[0]), (follower, tapes[1])):
            rig.executor.listen(partial(_note, tape))
        usage = time.process_time()
        time.sleep(seconds)
        usage = time.process_time() - usage
        late, status = follower.arm.state.late_ticks - late, teleop.status
        teleop.stop()
    t0, t1 = max(tape[0][0] for tape in tapes), min(tape[-1][0] for tape in tapes)
    t = np.arange(t0, t1, 0.005)
    angles = []
    for tape in tapes:
        rows = np.array(tape)
        columns = [np.interp(t, rows[:, 0], rows[:, i]) for i in range(1, 6)]
        angles.append(np.degrees(np.array(columns).T))
    return {
        "what": "in real time",
        **figures(angles[0], angles[1], 0.005),
        "ended": status.phase.value,
        "late ticks": late,
        "processor share": usage / seconds,
    }


def _note(tape: list[Any], state: JointState) -> None:
    tape.append((state.t, *state.q))


def _script(seconds: float) -> str:
    """A hand that raises the arm and leads all joints from 8 s on."""
    angles = _bench.human_motion(seconds, SEEDS[0]) + RAISED
    lines = []
    for joint, column in zip(_bench.JOINTS, angles.T, strict=True):
        lines += [f"0 {joint} start", f"3 {joint} {column[0]:.4f}"]
        lines += [f"{8.0 + 0.01 * k:.2f} {joint} {q:.4f}" for k, q in enumerate(column)]
    return "\n".join(lines) + "\n"


BARS = {
    "what": "bar",
    "2 s: median": 0.025,
    "2 s: p99": 0.045,
    "rms after it [deg]": 1.5,
    "slower setpoints after [s]": 0.1,
}


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--minutes", type=float, default=30.0)
    arguments.add_argument("--before", metavar="COMMIT", help="compare with it, nothing else")
    given = arguments.parse_args()
    if given.before is not None:
        _common.write("bench_teleop_before", list(compared(given.before)))
        return
    minutes = given.minutes
    rows = [live(SECONDS), *costing()]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        long_run = pool.submit(lasting, minutes) if minutes > 0.0 else None
        rows += pool.submit(_on_one_clock).result()
        if long_run is not None:
            rows.append(long_run.result())
    _common.write("bench_teleop", [*rows, BARS])


def _on_one_clock() -> list[dict[str, Any]]:
    return [*following(), *following_late(), *losing()]


if __name__ == "__main__":
    main()
