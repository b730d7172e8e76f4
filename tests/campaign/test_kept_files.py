"""A short share of ``kept_files.py``, the attack on the files we write."""

import json
import random
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks")

IN_PLACE = """
import json, sys
from campaign import kept_files

def write(folder, n):
    (folder / "careless.txt").write_text(f"{n} " * 5000)

def read(folder):
    (number,) = set((folder / "careless.txt").read_text().split())
    return int(number)

kept_files.KINDS = (kept_files.Kept("careless", write, read),)
json.dump(kept_files.run(1, 5), sys.stdout)
"""


def told(*arguments):
    done = subprocess.run(
        [sys.executable, *arguments],
        check=True,
        timeout=100,
        capture_output=True,
        cwd=TESTS,
        env={"PYTHONPATH": str(TESTS), "OPENBLAS_NUM_THREADS": "1"},
    )
    return json.loads(done.stdout)


def test_a_killed_writer_no_room_and_a_read_only_folder_leave_every_file_as_it_was(request):
    seed = random.Random(request.config.option.hypothesis_seed).randrange(10**6)
    found = told("-m", "campaign.kept_files", f"--seed={seed}", "--each=2")
    assert found["failures"] == [], f"seed {seed}"
    assert found["done"]["killed at a step"] > 20
    assert found["done"]["in a read-only folder"] == 11


def test_a_writer_that_writes_in_place_is_found_out():
    failures = " ".join(told("-c", IN_PLACE)["failures"])
    for what in ("killed when", "no room", "read-only"):
        assert what in failures
