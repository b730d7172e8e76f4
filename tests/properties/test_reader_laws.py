"""Broken input for every reader: it is read, or refused with an error of ours, soon."""

import json
import random
import resource
import time

import pytest
from harness.readers import ALL, OURS
from hypothesis import given, settings
from hypothesis import strategies as st

LONGEST = 1.0  # [s] of the processor that a reader may take
LARGEST = 200 << 10  # [KiB] that it may add to the process
MOST = 60_000  # bytes of an input
EACH = 100  # inputs of a seed; a draw of hypothesis for each would take twenty times as long

PIECES = (b"", b"\0", b"\1", b"\x7f", b"\x80", b"\xff", b'"', b"[", b"{", b"\xff" * 4, b"\0" * 4,
          b"1e30", b"-1 ", b"nan ")  # fmt: skip
VALUES = (
    0, -1, 1, 255, 256, 4095, 4096, 65535, 2**31, -(2**31), 2**63, 10**30, 10**400, 0.1, -0.0,
    1e-320, 1e30, 1e308, -1e308, float("inf"), float("-inf"), float("nan"), None, True, False,
    "", "a", "é" * 300, "\ud800", "\x00", [], {}, [[]], {"a": {}}, "1e999",
)  # fmt: skip


def with_other_bytes(rng, data):
    """Some bytes left out, others put in their place."""
    begin = rng.randrange(len(data) + 1)
    end = begin + rng.choice((0, 1, 2, 8, 64))
    again = data[begin : begin + rng.choice((0, 0, 4, 32, 256))]
    return data[:begin] + rng.choice((*PIECES, rng.randbytes(1))) + again + data[end:]


def places_in(content):
    """Pairs of a list or an object and a key of it, for all values in a JSON text."""
    if isinstance(content, dict | list):
        for key in content if isinstance(content, dict) else range(len(content)):
            yield content, key
            yield from places_in(content[key])


def with_another_value(rng, data):
    """A JSON text with one value of it left out, changed, multiplied or under another name."""
    try:
        places = list(places_in(json.loads(data)))
    except (ValueError, RecursionError):
        places = []
    if not places:
        return with_other_bytes(rng, data)
    content = places[0][0]
    holder, key = rng.choice(places)
    change = rng.choice(("value", "value", "value", "left out", "many", "name"))
    if change == "left out":
        del holder[key]
    elif change == "many" and isinstance(holder, list):
        holder += holder[: rng.choice((1, 10, 300))]
    elif change == "name" and isinstance(holder, dict):
        holder[rng.choice(("", "a", "name", "id", "é", *holder))] = holder.pop(key)
    else:
        there, at = rng.choice(places)
        holder[key] = rng.choice((rng.choice(VALUES), rng.choice(VALUES), there[at]))
    try:
        return json.dumps(content).encode(errors="surrogatepass")
    except (ValueError, RecursionError):  # it holds itself now
        return data


def broken(rng, seeds):
    """What is made of a good input by a few changes."""
    data = rng.choice(seeds)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        data = rng.choice((with_other_bytes, with_another_value, with_another_value))(rng, data)
    return data[:MOST]


@pytest.mark.parametrize("reader", ALL, ids=[reader.name for reader in ALL])
@settings(max_examples=5)
@given(seed=st.integers(0, 2**32))
def test_a_reader_refuses_what_it_cannot_read_soon_and_with_an_error_of_ours(reader, seed):
    rng = random.Random(seed)
    for _ in range(EACH):
        data, refusal = broken(rng, reader.seeds), ""
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        begin = time.process_time()  # others may have the processor meanwhile
        try:
            reader.read(data)
        except OURS as refused:
            refusal = str(refused)
        except Exception as error:
            raise AssertionError(data) from error
        took = time.process_time() - begin
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory
        assert refusal.isprintable(), data
        assert (took < LONGEST, grown < LARGEST) == (True, True), data


@pytest.mark.parametrize("reader", ALL, ids=[reader.name for reader in ALL])
def test_the_good_inputs_are_read(reader):
    if reader.name in ("attributes", "faults and hands"):
        pytest.skip("each input is for one of several readers")
    for seed in reader.seeds:
        reader.read(seed)
