"""Broken inputs for the readers, bred by the lines of code they reach.

An input that reaches a line of ours that none has reached before is kept and mutated further.
Tracing costs ten times the reading, so one input in eight is traced. All of it follows the seed.
"""

import contextlib
import json
import random
import resource
import sys
import time
import traceback
from collections import Counter
from dataclasses import dataclass, field

LONGEST = 1.0  # [s] that a reader may take
LARGEST = 200 << 10  # [KiB] that it may add to the process
TRACED = 8
_NUMBERS = (
    0, -1, 1, 255, 256, 4095, 4096, 65535, 2**31, -(2**31), 2**63, 10**30, 10**400, 0.1, -0.0,
    1e-320, 1e30, 1e308, -1e308, float("inf"), float("-inf"), float("nan"),
)  # fmt: skip
_OTHERS = (
    None,
    True,
    False,
    "",
    "a",
    "é" * 300,
    "\ud800",
    "\x00",
    [],
    {},
    [[]],
    {"a": {}},
    "1e999",
)


@dataclass
class Outcome:
    """How a reader did: failures by kind and place, with an input; the longest time for one [s]."""

    executions: int = 0
    refused: int = 0
    kept: int = 0
    lines: int = 0
    slowest: float = 0.0
    failures: dict = field(default_factory=dict)
    counts: Counter = field(default_factory=Counter)


def attack(reader, ours, *, seed, executions=10**9, seconds=1e9):
    """Feed a reader until one of the bounds; its outcome."""
    rng = random.Random(f"{seed} {reader.name}")
    outcome, reached, pool = Outcome(), set(), list(reader.seeds)
    for data in reader.seeds:
        with contextlib.suppress(*ours):
            reader.read(data)  # what is imported now is not the reader's time
        _try(reader, ours, data, outcome, reached)
    end = time.monotonic() + seconds
    while outcome.executions < executions and time.monotonic() < end:
        data = _changed(rng, pool)
        is_traced = outcome.executions % TRACED == 0
        before = len(reached)
        _try(reader, ours, data, outcome, reached if is_traced else None)
        if len(reached) > before and len(data) < 20_000:
            pool.append(data)
            outcome.kept += 1
    outcome.lines = len(reached)
    return outcome


def _try(reader, ours, data, outcome, reached):
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.process_time()  # others may have the processor meanwhile
    try:
        if reached is None:
            reader.read(data)
        else:
            _traced(reader.read, data, reached)
    except ours as error:
        outcome.refused += 1
        if not str(error).isprintable():
            _note(outcome, "a refusal that cannot be printed", data)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        _note(outcome, f"{type(error).__name__} at {place.filename}:{place.lineno}: {error}", data)
    took = time.process_time() - begin
    outcome.slowest = max(outcome.slowest, took)
    outcome.executions += 1
    if took > LONGEST:
        _note(outcome, "took more than a second", data)
    if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory > LARGEST:
        _note(outcome, "took more than 200 MB", data)


def _note(outcome, what, data):
    kind = what.partition(": ")[0]
    outcome.counts[kind] += 1
    outcome.failures.setdefault(kind, (what[:300], data))


def _traced(read, data, reached):
    def line(frame, event, _):
        if event == "line":
            reached.add((frame.f_code, frame.f_lineno))
        return line

    def call(frame, _, __):
        return line if "so101_motion" in frame.f_code.co_filename else None

    before = sys.gettrace()
    sys.settrace(call)
    try:
        read(data)
    finally:
        sys.settrace(before)


# Changes


def _changed(rng, pool):
    data = rng.choice(pool)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        change = rng.choice((_bytes_changed, _value_changed, _value_changed, _spliced))
        data = change(rng, data, pool)
    return data[:60_000]


def _bytes_changed(rng, data, _):
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        at = rng.randrange(len(out) + 1)
        match rng.randrange(6):
            case 0:
                out[at:at] = bytes((rng.randrange(256),))
            case 1:
                del out[at : at + rng.choice((1, 2, 8, 64))]
            case 2:
                out[at : at + 1] = bytes((rng.choice((0, 1, 127, 128, 255, 34, 91, 123)),))
            case 3 if out:
                out[at % len(out)] ^= 1 << rng.randrange(8)
            case 4:
                out[at:at] = out[at : at + rng.choice((4, 32, 256))]
            case _:
                out[at : at + 4] = rng.choice((b"\xff" * 4, b"\0" * 4, b"1e30", b"-1 ", b"nan "))
    return bytes(out)


def _spliced(rng, data, pool):
    other = rng.choice(pool)
    return data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1) :]


def _value_changed(rng, data, pool):
    """A JSON text with one value of it changed, if it is one."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        return _bytes_changed(rng, data, pool)
    places = []
    _walk(content, places, 0)
    if not places:
        return _bytes_changed(rng, data, pool)
    holder, key = rng.choice(places)
    match rng.randrange(6):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, list):
            holder += holder[: rng.choice((1, 10, 300))]
        case 1 | 2:
            other, its_key = rng.choice(places)
            holder[key] = json.loads(json.dumps(other[its_key])) if its_key in _keys(other) else 0
        case 3 if isinstance(holder, dict):
            holder[rng.choice(("", "a", "name", "id", "é", *holder))] = holder.pop(key)
        case _:
            holder[key] = rng.choice(_NUMBERS if rng.random() < 0.6 else _OTHERS)
    try:
        return json.dumps(content).encode(errors="surrogatepass")
    except (ValueError, RecursionError):
        return data


def _keys(holder):
    return holder if isinstance(holder, dict) else range(len(holder))


def _walk(content, places, depth):
    if depth > 20 or not isinstance(content, dict | list):
        return
    for key in list(_keys(content))[:50]:
        places.append((content, key))
        _walk(content[key], places, depth + 1)
