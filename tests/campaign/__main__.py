"""``python -m campaign --minutes 10``: attack for so long, write what came of it, fail on any."""

import argparse
import contextlib
import json
import logging
import sys
import time
from pathlib import Path

from campaign.interleavings import run
from campaign.mutator import attack
from campaign.readers import OURS, all_readers

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "campaign.json"
SHARES = {"readers": 0.4, "interleavings": 0.3, "faults": 0.3}
MOST_TOLD = 50


def attack_readers(seed, seconds):
    told, begin = {}, time.monotonic()
    readers = all_readers()
    for k, reader in enumerate(readers):
        left = seconds - (time.monotonic() - begin)
        outcome = attack(reader, OURS, seed=seed, seconds=left / (len(readers) - k))
        told[reader.name] = {
            "executions": outcome.executions,
            "refused": outcome.refused,
            "lines_reached": outcome.lines,
            "slowest_s": round(outcome.slowest, 3),
            "failures": [text for text, _ in outcome.failures.values()],
        }
        for text, data in outcome.failures.values():
            print(f"{reader.name}: {text}\n  with {data[:200]!r}")
    total = sum(each["executions"] for each in told.values())
    return {"executions": total, "each": told}


def interleave(seed, seconds, *, faulty):
    end, count, pretended, requests, broken = time.monotonic() + seconds, 0, 0.0, {}, []
    while time.monotonic() < end:
        done, passed, objections = run(f"{seed}-{count}", count=50, faulty=faulty)
        count, pretended, broken = count + 50, pretended + passed, broken + objections
        for name, times in done.items():
            requests[name] = requests.get(name, 0) + times
        for text in objections:
            print(text)
    return {
        "interleavings": count,
        "pretended_s": round(pretended),
        "requests": dict(sorted(requests.items())),
        "failures": broken[:MOST_TOLD],
        "failure_count": len(broken),
    }


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--only", choices=SHARES, action="append")
    asked = parser.parse_args()
    logging.disable(logging.CRITICAL)
    chosen = asked.only or list(SHARES)
    unit = 60.0 * asked.minutes / sum(SHARES[name] for name in chosen)
    told = {"seed": asked.seed}
    if "readers" in chosen:
        told["readers"] = attack_readers(asked.seed, unit * SHARES["readers"])
    for name in ("interleavings", "faults"):
        if name in chosen:
            seconds = unit * SHARES[name]
            told[name] = interleave(asked.seed, seconds, faulty=name == "faults")
    before = {}
    with contextlib.suppress(OSError, ValueError):
        before = json.loads(RESULTS.read_text())
    for name in chosen:
        before[name] = {"seed": asked.seed, "minutes": asked.minutes, **told[name]}
    RESULTS.write_text(json.dumps(before, indent=1) + "\n")
    failed = [each["failures"] for each in told.get("readers", {}).get("each", {}).values()]
    failed += [told[name]["failures"] for name in told if name in ("interleavings", "faults")]
    print(f"seed {asked.seed}: {sum(map(len, failed))} kinds of failure; see {RESULTS.name}")
    return 1 if any(failed) else 0


if __name__ == "__main__":
    sys.exit(main())
