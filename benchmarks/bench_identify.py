"""Compare what emulated arms identify about their servos with the true figures.

Each emulated arm has servos of its own (spread 0.2). It is identified with an empty hand, then with
a load that it is to weigh. What the figures predict is compared with the truth: how far a joint
droops under 1 N m, at which torque a limp joint breaks away, how far a joint is behind its
setpoint, and play. Then random paths at 90 deg/s are followed without the figures, with them, and
with the true ones, with the load, which the driver does not know. The referee judges every command
and the caps of every goal; how fast the joints truly turned and how near their bodies came to the
table and to one another is measured in the emulated world, every ``LOOK``.

The servos are emulated: fitted on recordings of one real servo, see ``docs/emulator.md``.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import _common
from so101_motion.calib.record import servo_file, store
from so101_motion.calib.record.servo_file import ServoRecord
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.emulator.emulator import differing_servos
from so101_motion.drivers.emulator.joint_figures import SO101
from so101_motion.drivers.feetech.servo_model import ServoModel
from so101_motion.drivers.servo_types import STS3215_12V, ServoFigures
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.torque import place_in_hand
from so101_motion.setup.identify import Identification, IdentifyReport

LOADS_KG = (0.1, 0.15, 0.2, 0.3)

_following: Any = _common.from_tests("harness.path_following")
_harness: Any = _common.from_tests("harness.emulated_rig")
_referee: Any = _common.from_tests("referee.official")


LOOK = 0.05
"""How often the true joints are looked at [s]; chosen."""


class Travel(NamedTuple):
    """What an identification did to the arm.

    Attributes:
        took: How long the arm moved [s].
        speed: The fastest joint over one ``LOOK``, as a share of its cap.
        distance: The least distance of two bodies, the table included [m].
    """

    took: float
    speed: float
    distance: float


def identified(bench: Any, file: Path, *, is_empty: bool) -> tuple[IdentifyReport, Travel]:
    """Identify the arm on ``bench``; the report, and how the arm moved for it."""
    rig = _opened(bench, file)
    begin = bench.clock.now()
    identification = Identification(rig)
    outline = identification.outline()
    if outline.obstacles:
        raise SystemExit(f"not all joints can be moved: {outline.obstacles}")
    bodies, caps = CollisionModel(rig.arm.model, rig.arm.scene), rig.arm.limits.velocity
    speed, distance, before = 0.0, math.inf, np.array(bench.world.q)
    with ThreadPoolExecutor(1) as beside:
        moving = beside.submit(identification.move_and_record, outline)
        while not moving.done():
            bench.advance(LOOK)
            q = np.array(bench.world.q)
            speed = max(speed, float(np.max(np.abs(q - before)[:5] / LOOK / caps)))
            distance, before = min(distance, bodies.clearance(q[:5], q[5]).distance), q
        moving.result()
    travel = Travel(bench.clock.now() - begin, speed, distance)
    return identification.report(hand_is_empty=is_empty, keeps=is_empty), travel


def tracking(bench: Any, file: Path, seed: int, plans: int) -> float:
    """Mean of how far joints are from their setpoints while they move [deg]."""
    rig = _opened(bench, file)
    rig.arm.set_speed(math.radians(90.0))
    rig.arm.set_acceleration(math.radians(300.0))
    off = []
    for k in range(plans):
        plan, _ = _following.random_plan(rig, 100 * seed + k)
        motion = rig.arm.move(plan, wait=False)
        while not motion.future.done():
            bench.advance(0.01)
            off.append(np.abs(bench.arm_deg(rig) - np.degrees(rig.arm.state.q_ref)))
        motion.result(timeout=0.0)
    return float(np.mean(off))


def _opened(bench: Any, file: Path) -> Any:
    zeros = dict(zip(ARM_JOINTS, np.radians(_harness.MIDDLES_DEG), strict=True))
    if not file.exists():
        rig = bench.open(zero_offsets=zeros)
        store.save(file, rig.servos.calibration)
        bench.shut(rig)
    rig = bench.open(zero_offsets=zeros, calibration_file=file)
    bench.advance(1.0)
    return rig


def errors(true: ServoFigures, found: ServoFigures) -> dict[str, float]:
    """Errors of the predictions, as shares of the true values."""
    is_, seems = (ServoModel(STS3215_12V, 32, figures=each) for each in (true, found))

    def share(seen: float, real: float) -> float:
        return abs(seen / real - 1.0)

    def droop(model: ServoModel) -> float:
        return model.distance(1.0 + model.friction(1.0, 1.0))

    return {
        "droop": share(droop(seems), droop(is_)),
        "break-away": share(seems.kind.break_away, is_.kind.break_away),
        "lag": share(seems.lag, is_.lag),
        "play": math.nan if found.play is None else share(found.play, is_.kind.play),
    }


def found_by(seed: int) -> dict[str, Any]:
    """Let one arm identify its servos, and compare with the true figures."""
    load = LOADS_KG[seed % len(LOADS_KG)]
    options = {"reply_timeout": 2.0, "spread": 0.2, "seed": seed}
    with (
        _referee.refereed(("motion",)),
        tempfile.TemporaryDirectory() as folder,
    ):
        file = Path(folder) / "arm.json"
        with _harness.hardware_bench(Path(folder), **options) as bench:
            empty, travel = identified(bench, file, is_empty=True)
        with _harness.hardware_bench(Path(folder), held_kg=load, **options) as bench:
            carrying, again = identified(bench, file, is_empty=False)
    servos = empty.found.servos
    found = carrying.found.load
    assert found is not None
    place = np.linalg.norm(np.array(found.com) - place_in_hand(RobotModel.load()))
    by_joint = {joint: errors(is_, servos[joint]) for joint, is_ in true_figures(seed).items()}
    return {
        "figures": {joint: asdict(each) for joint, each in servos.items()},
        "joints": by_joint, "took": travel.took, "speed": max(travel.speed, again.speed),
        "distance": min(travel.distance, again.distance),
        "mass": abs(found.mass - load), "place": float(place),
    }  # fmt: skip


def true_figures(seed: int) -> dict[str, ServoFigures]:
    """An arm's true servo figures."""
    found = {}
    for joint, kind in list(differing_servos(SO101, STS3215_12V, spread=0.2, seed=seed))[:5]:
        found[joint.name] = ServoFigures(
            torque=kind.torque_per_volt / STS3215_12V.torque_per_volt,
            friction=kind.coulomb / STS3215_12V.coulomb,
            dead_time=kind.goal_delay / STS3215_12V.goal_delay,
            play=kind.play,
        )
    return found


def followed(seed: int, plans: int, known: dict[str, Any] | None) -> float:
    """Errors of an arm that carries a load, against its setpoints [deg].

    Args:
        seed: Which arm.
        plans: How many random paths.
        known: The figures of its servos, by joint; None if nobody has identified them.
    """
    load = LOADS_KG[seed % len(LOADS_KG)]
    with (
        _referee.refereed(("motion",)),
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(
            Path(folder), held_kg=load, reply_timeout=2.0, spread=0.2, seed=seed
        ) as bench,
    ):
        file = Path(folder) / "arm.json"
        if known is not None:
            servos = {joint: ServoFigures(**each) for joint, each in known.items()}
            servo_file.save(file, ServoRecord(at="", volts=12.0, servos=servos))
        return tracking(bench, file, seed, plans)


def _as_json(figures: dict[str, ServoFigures]) -> dict[str, Any]:
    return {joint: asdict(own) for joint, own in figures.items()}


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--plans", type=int, default=2)
    parser.add_argument("--since", metavar="COMMIT", help="arms know what they found out then")
    parser.add_argument(
        "--part", type=int, nargs=2, metavar=("K", "N"), help="only every N-th arm; writes nothing"
    )
    asked = parser.parse_args()
    seeds = range(1, asked.arms + 1)
    if asked.part:
        seeds = seeds[asked.part[0] - 1 :: asked.part[1]]
    arms = _common.in_pieces(
        "bench_identify", {f"arm {seed}": partial(found_by, seed) for seed in seeds}, asked.since
    )
    for when, figures in (
        ("before", [None] * len(arms)),
        ("after", [arm["figures"] for arm in arms]),
        ("best", [_as_json(true_figures(seed)) for seed in seeds]),
    ):
        ways = {
            f"arm {seed}, {asked.plans} plans, {when}": partial(followed, seed, asked.plans, known)
            for seed, known in zip(seeds, figures, strict=True)
        }
        for arm, error in zip(arms, _common.in_pieces("bench_identify", ways), strict=True):
            arm[when] = error
            arm[f"{when}, share"] = error / arm["before"]
    if asked.part:
        return
    rows: list[dict[str, Any]] = []
    for what, bar in (("droop", 0.1), ("break-away", 0.2), ("lag", 0.1), ("play", 0.1)):
        for joints in (ARM_JOINTS[1:4], (ARM_JOINTS[0], ARM_JOINTS[4])):
            off = np.array([arm["joints"][joint][what] for arm in arms for joint in joints])
            at, joint = divmod(int(np.nanargmax(off)), len(joints))
            rows.append(
                {
                    "what": f"{what}, predicted, share off; {' '.join(joints)}",
                    "n": off.size,
                    "median": float(np.nanmedian(off)),
                    "p90": float(np.nanpercentile(off, 90.0)),
                    "worst": float(np.nanmax(off)),
                    "worst at": f"arm {seeds[at]}, {joints[joint]}",
                    "not seen": int(np.isnan(off).sum()),
                    "bar": bar,
                }
            )
    for what, key, scale, bar in (
        ("mass of the load off [g]", "mass", 1e3, 15.0),
        ("its place off [mm]", "place", 1e3, 10.0),
        ("duration [s]", "took", 1.0, 180.0),
        ("fastest joint, share of its cap", "speed", 1.0, 1.0),
        ("tracking error before [deg]", "before", 1.0, math.inf),
        ("tracking error after [deg]", "after", 1.0, math.inf),
        ("tracking error after, share of before", "after, share", 1.0, 0.6),
        ("with exact figures, share of before", "best, share", 1.0, math.inf),
    ):
        values = scale * np.array([arm[key] for arm in arms])
        rows.append(
            {
                "what": what,
                "n": values.size,
                "median": float(np.median(values)),
                "p90": float(np.percentile(values, 90.0)),
                "worst": float(np.max(values)),
                "bar": bar if bar < math.inf else "-",
            }
        )
    near = 1e3 * np.array([arm["distance"] for arm in arms])
    nearest = {"median": float(np.median(near)), "worst": float(near.min())}
    what = "least distance of two bodies, the table included [mm]"
    rows.append({"what": what, "n": near.size, **nearest, "bar": "> 0"})
    before = sum(arm["before"] for arm in arms)
    for when, what in (("after", "after"), ("best", "with exact figures")):
        share = sum(arm[when] for arm in arms) / before
        rows.append(
            {"what": f"tracking error {what}, all arms, share", "median": share, "bar": "-"}
        )
    _common.write("bench_identify", rows)


if __name__ == "__main__":
    main()
