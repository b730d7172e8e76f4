"""``make campaign MINUTES=10``, or parts of it: attack, write the counts down, fail on any finding.

    PYTHONPATH=tests python -m campaign --only "torn answers" --count 100000 --seed 3

Each run has a seed of its own. The counts of all runs add up in
``benchmarks/results/campaign.json``, part by part.
"""

import argparse
import json
import logging
import subprocess
import sys
import tempfile
import time
from functools import cache, partial
from pathlib import Path

import numpy as np
from referee.official import refereed

from campaign import (
    good_answers,
    interleavings,
    sessions,
    signals,
    spoilt_arms,
    targets,
    torn_answers,
    verdicts,
)
from so101_motion.files import atomic
from so101_motion.planning.kinematics.model import RobotModel

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "campaign.json"
MOST_TOLD = 50
LARGEST = ("fastest_deg_per_s",)
"""Of these figures the largest counts; all others add up."""


model = cache(RobotModel.load)


def in_pieces(key, piece):
    """``piece(name, k, left, end)`` again and again, until ``count`` of ``key`` are done."""

    def run(seed, seconds, count):
        told, end, k = {}, time.monotonic() + seconds, 0
        while told.get(key, 0) < count and time.monotonic() < end:
            told = added(told, piece(f"{seed}{k:03}", k, count - told.get(key, 0), end))
            k += 1
        return told

    return run


def spoil_answers(name, k, left, end):
    """Spoiled answers, now and then few of all, mostly half."""
    share = 0.15 if k % 8 == 0 else 0.5
    tally = torn_answers.run(min(left, 5_000), seed=int(name), share=share)
    return {
        "spoiled": tally.total,
        "each": dict(sorted(tally.spoiled.items())),
        "answers": tally.answers,
        "cycles": tally.cycles,
        "errors": dict(sorted(tally.faults.items())),
        "failures": [f"share {share}, {broken}" for broken in tally.broken],
    }


def handle_roughly(name, k, left, end):
    seen, again, fastest = good_answers.run(min(left, 20_000), seed=int(name))
    return {"answers": seen, "refused": again, "fastest_deg_per_s": round(fastest)}


def count_good_answers(seed, seconds, count):
    """``count`` good answers of joints that are treated roughly."""
    told = in_pieces("answers", handle_roughly)(seed, seconds, count)
    too_many = told["refused"] * 100_000 > max(told["answers"], 100_000)
    failures = [f"seed {seed}: {told['refused']} of {told['answers']} good answers refused"]
    return told | {"failures": failures if too_many else []}


def interleave(name, k, left, end, *, faulty=False):
    count = 50 if faulty else min(50, left)
    done, passed, broken = interleavings.run(name, count=count, faulty=faulty)
    return {
        "interleavings": count,
        "simulated_s": round(passed),
        "each": dict(sorted(done.items())),
        "failures": broken,
    }


def play_sessions(name, k, left, end):
    """Sessions with a module process, ten of them with one."""
    return sessions.run(name, seconds=end - time.monotonic(), sessions=min(left, 10))


def compare_verdicts(name, k, left, end):
    """Configurations, checked by the compiled library and by coal."""
    return verdicts.compare(np.random.default_rng(int(name)), model(), verdicts.PER_SCENE)


def send_targets(name, k, left, end):
    """Targets of every kind to an arm that follows them, a new arm for each thousand."""
    seed, count = int(name), min(left, 1_000)
    try:
        with tempfile.TemporaryDirectory() as folder, refereed():
            outcome = targets.attack(Path(folder), seed=seed, count=count, fast=k % 2 == 0)
    except AssertionError as error:  # the referee's
        return {"failures": [f"seed {name}: {error}"]}
    return {
        "targets": outcome.sent.total(),
        "each": dict(sorted(outcome.sent.items())),
        "failures": [f"seed {name}: {text}" for text in outcome.contacts + outcome.broken],
    }


def send_signals(seed, seconds, count):
    """``count`` signals to verbs of the command line."""
    return signals.run(seed, seconds=seconds, count=count)


ENDLESS = 10**9
PARTS = {
    "verdicts": (0.05, in_pieces("configurations", compare_verdicts), ENDLESS, 10_000_000),
    "torn answers": (0.2, in_pieces("spoiled", spoil_answers), ENDLESS, 1_000_000),
    "good answers": (0.05, count_good_answers, ENDLESS, 1_000_000),
    "interleavings": (0.15, in_pieces("interleavings", interleave), ENDLESS, 10_000),
    "faults": (0.15, in_pieces("simulated_s", partial(interleave, faulty=True)), ENDLESS, 7_200),
    "sessions": (0.2, in_pieces("sessions", play_sessions), ENDLESS, 200),
    "signals": (0.1, send_signals, ENDLESS, 200 * len(signals.VERBS)),
    "targets": (0.05, in_pieces("targets", send_targets), ENDLESS, 10_000),
    "spoilt arms": (0.05, spoilt_arms.run, ENDLESS, 2_000),
}
"""Share of the time, what runs, and how many: if it is not said, and for ``--full``."""


def added(one, other):
    """Two pieces of results as one."""
    total = dict(one)
    for key, value in other.items():
        if key not in total:
            total[key] = value
        elif isinstance(value, dict):
            total[key] = added(total[key], value)
        elif key in LARGEST:
            total[key] = max(total[key], value)
        elif key != "wanted" and not isinstance(value, str):
            total[key] = total[key] + value
    return total


def commit():
    """Which code this is; ``-dirty`` if files differ from it."""
    told = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--exclude=*"],
        cwd=Path(__file__).parent, check=False, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    return told.stdout.strip() or "unknown"


def keep(part, figures, file):
    """Add a piece to what is written down."""
    with atomic.locked(file.parent):
        known = json.loads(file.read_text()) if file.exists() else {}
        before = known.get(part, {})
        total = added(before, figures)
        total["failure_count"] = before.get("failure_count", 0) + len(figures["failures"])
        total["failures"] = total["failures"][:MOST_TOLD]
        known[part] = total
        atomic.write(file, json.dumps(known, indent=1).encode() + b"\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, help="how long, all parts together")
    parser.add_argument("--count", type=int, help="how many instead, of one part")
    parser.add_argument("--full", action="store_true", help="all counts in full; two hours")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--only", choices=PARTS, action="append", help="which parts")
    parser.add_argument("--results", type=Path, default=RESULTS, help="where to add it up")
    asked = parser.parse_args()
    logging.disable(logging.CRITICAL)
    chosen = asked.only or list(PARTS)
    is_counted = asked.full or asked.count is not None
    minutes = asked.minutes or (1e6 if is_counted else 10.0)
    unit = 60.0 * minutes / max(sum(PARTS[name][0] for name in chosen), 1e-9)
    failed = 0
    for name in chosen:
        share, attack_it, usual, full = PARTS[name]
        count = asked.count or (full if asked.full else usual)
        begin = time.monotonic()
        figures = attack_it(asked.seed, unit * share, count)
        figures |= {"seeds": [asked.seed], "minutes": round((time.monotonic() - begin) / 60.0, 1)}
        plain = {key: value for key, value in figures.items() if isinstance(value, int | float)}
        figures["pieces"] = [{"seed": asked.seed, "commit": commit(), **plain}]
        keep(name, figures, asked.results)
        print(f"{name}, seed {asked.seed}: {plain}, {len(figures['failures'])} failures")
        for text in figures["failures"]:
            print(f"  {text}")
        failed += len(figures["failures"])
    print(f"{failed} failures; see {asked.results}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
