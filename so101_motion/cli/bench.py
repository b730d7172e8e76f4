"""``so101 bench``: measure planning, the control loop and the bus on this computer.

Nothing moves and the joints stay limp. The benchmarks of the repository measure far more; this verb
is for the computer and the port at hand.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from so101_motion.cli.options import JSON, verb
from so101_motion.cli.shared import busy_message, print_json, quietly
from so101_motion.cli.sources import ANY_SOURCE, AnySource, MachineSource, Source

if TYPE_CHECKING:
    from so101_motion.common.state import JointState
    from so101_motion.rig.bus_lease import BusLease
    from so101_motion.rig.rig import Rig
    from so101_motion.viam.client import MachineRig

_PLANS = 40
"""Motions of each kind; chosen, two seconds in all."""

_LOOP = 3.0
"""How long the control loop is measured [s]; chosen: 300 periods."""

_ASKED = 100
"""Number of status requests to a machine; chosen."""


class Figure(NamedTuple):
    """One measured figure.

    Attributes:
        name: Its key for programs.
        words: Its description for people.
        n: Number of measurements.
        times: Their median, 99th percentile and largest [s].
        remark: A further note for people; empty without one.
    """

    name: str
    words: str
    n: int
    times: tuple[float, float, float]
    remark: str = ""

    @classmethod
    def of(cls, name: str, words: str, values: Sequence[float]) -> Figure:
        """Make the figure from single measurements [s]."""
        median, p99, worst = np.percentile(values, [50, 99, 100]).tolist()
        return cls(name, words, len(values), (median, p99, worst))


@verb()
def bench(source: AnySource = ANY_SOURCE, as_json: bool = JSON) -> None:
    """Measure planning, the control loop and the bus on this computer, in ten seconds.

    Nothing moves. With --port the servos are read as the control loop reads them; with --machine
    the connection to the machine is measured.

    \b
    so101 bench --sim
    so101 bench --port /dev/ttyACM0 --json
    """  # noqa: D301
    from so101_motion.setup.findings import software

    with quietly():
        if isinstance(source, MachineSource):
            with closing(source.open()) as rig, busy_message("asking the machine"):
                arm_figures = [_status_requests(rig)]
        else:
            arm_figures = _loop_and_bus(source)
        with busy_message("planning"):
            figures = [*_planning(), *arm_figures]
    about = dict(software())
    if as_json:
        rounded = {each.name: _facts(each) for each in figures}
        print_json("bench", {"source": source.what, "software": about, "figures": rounded})
    else:
        _print_table(source.what, figures)


def _planning() -> list[Figure]:
    """Plan random joint goals and points on the simulated arm, in the planning process."""
    from so101_motion.planning.goals import Goal, JointGoal, PoseGoal
    from so101_motion.rig.simulated_rig import open_simulated

    random = np.random.default_rng(1)
    begin = time.perf_counter()
    with open_simulated() as rig:
        arm = rig.arm
        arm.plan(JointGoal(q=np.radians([0.0, -45.0, 45.0, 60.0, 0.0])))
        first = time.perf_counter() - begin
        lower, upper = arm.range

        def joint_goal() -> Goal:
            return JointGoal(q=lower + (upper - lower) * random.uniform(0.2, 0.8, 5))

        def point() -> Goal:
            angle, reach = random.uniform(-1.2, 1.2), random.uniform(0.18, 0.32)
            x, y = reach * np.cos(angle), reach * np.sin(angle)
            return PoseGoal.at_point(np.array([x, y, random.uniform(0.05, 0.25)]))

        return [
            Figure.of("start", "starting the planner, with a first plan", [first]),
            Figure.of("plan_joints", "planning to joint angles", _timed(arm.plan, joint_goal)),
            Figure.of("plan_point", "planning to a point", _timed(arm.plan, point)),
        ]


def _timed(plan: Callable[..., object], goal: Callable[[], object]) -> list[float]:
    """The times of plans [s]; goals without a plan are replaced by others."""
    from so101_motion.common.errors import PlanningError

    times: list[float] = []
    for _ in range(4 * _PLANS):
        wanted, begin = goal(), time.perf_counter()
        try:
            plan(wanted)
        except PlanningError:
            continue
        times.append(time.perf_counter() - begin)
        if len(times) == _PLANS:
            break
    return times


def _loop_and_bus(source: Source) -> list[Figure]:
    if source.port is None:
        from so101_motion.rig.simulated_rig import open_simulated

        with open_simulated() as rig, busy_message("measuring the control loop"):
            return [_lateness(rig)]
    from so101_motion.cli.port_choice import lent_bus, look_at

    report = look_at(source.port)
    with lent_bus(report, "a benchmark") as (rig, lease):
        with busy_message("measuring the control loop"):
            late = _lateness(rig)
        if not report.servo_ids:
            return [late]
        with busy_message("reading the servos"):
            return [late, _bus(lease, report.servo_ids)]


def _bus(lease: BusLease, servo_ids: Sequence[int]) -> Figure:
    """Read all servos as the control loop does in every period."""
    from so101_motion.setup.findings import listen

    heard = lease.call(lambda bus: listen(bus, servo_ids))
    return Figure(
        name="bus",
        words=f"reading {len(servo_ids)} servos",
        n=heard.asked // len(servo_ids),
        times=(heard.median, heard.p99, heard.longest),
        remark=f"{heard.late} late, {heard.lost} lost, {heard.corrupt} garbled of {heard.asked}",
    )


def _lateness(rig: Rig) -> Figure:
    """The deviation of the control loop's periods."""
    moments: list[float] = []
    done = threading.Event()

    def note(_: JointState) -> None:
        moments.append(time.perf_counter())
        if len(moments) * rig.executor.dt > _LOOP:
            done.set()

    end = rig.executor.listen(note)
    done.wait(3.0 * _LOOP)
    end()
    periods = np.diff(moments[1:])
    words = f"control loop, off its {1e3 * rig.executor.dt:g} ms"
    return Figure.of("loop", words, np.abs(periods - rig.executor.dt).tolist())


def _status_requests(rig: MachineRig) -> Figure:
    """How long a machine takes to answer a status request."""
    times = []
    for _ in range(_ASKED):
        begin = time.perf_counter()
        rig.refresh()
        times.append(time.perf_counter() - begin)
    return Figure.of("machine", "reading the machine's state", times)


def _facts(figure: Figure) -> dict[str, object]:
    """The figure for programs."""
    names = zip(("median", "p99", "worst"), figure.times, strict=True)
    rounded = {f"{name}_ms": round(1e3 * value, 3) for name, value in names}
    return {"n": figure.n, **rounded, "remark": figure.remark}


def _print_table(what: str, figures: Sequence[Figure]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, title=what, title_justify="left")
    table.add_column("")
    for heading in ("n", "median", "p99", "worst"):
        table.add_column(heading, justify="right", header_style="dim")
    table.add_column("")
    for figure in figures:
        columns = [f"{1e3 * value:.2f} ms" for value in figure.times]
        table.add_row(figure.words, str(figure.n), *columns, figure.remark)
    Console(highlight=False).print(table)
