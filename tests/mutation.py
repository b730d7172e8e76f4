"""What the tests are worth: mutmut changes the product, and a test should fail for each change.

    pip install -e '.[mutation]'
    python tests/mutation.py                          # a fixed sample of each room, its unit tests
    python tests/mutation.py --survivors --out all.json --again scores.json

All mutants would take days: a sample of each room is drawn with a fixed seed. ``--survivors``
tries on the wider tests of ``ROOMS`` what of ``--again`` no unit test caught; ``--again`` alone
tries the same mutants as an earlier run, if their functions have not changed. mutmut works on a
copy of the tree. It changes bodies of functions, neither constants of modules nor properties.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
# room of the product: its unit tests, and the tests of the rooms above that use it
ROOMS = {
    "control": ("unit/control", "unit/drivers/test_goal_limiter.py", "+unit/arm"),
    "planning/timing": ("unit/planning/timing", "+properties/test_trajectory_laws.py"),
    "calib/record": ("unit/calib/record", "+unit/calib/procedure", "+campaign/test_kept_files.py"),
    "drivers/bus": ("unit/drivers/bus", "+unit/drivers/feetech", "+bus/test_eeprom_writes.py"),
    "viam/conversion": (
        "unit/viam/conversion",
        "+unit/viam",
        "+properties/test_orientation_vectors.py",
    ),
}
KILLED = {1: "killed", 3: "killed", 0: "survived", 5: "no test", 33: "no test"}


def tests_of(rooms: list[str], wide: bool) -> list[str]:
    named = [each for room in rooms for each in ROOMS[room] if wide or not each.startswith("+")]
    return [f"tests/{each.removeprefix('+')}" for each in named]


def copy_of_the_tree(copy: Path, rooms: list[str], tests: list[str]) -> None:
    """Bring a copy up to date; what has not changed is not mutated again."""
    kept = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    for name in (*kept.stdout.decode().split("\0"), *map(str, ROOT.glob("so101_motion/**/*.so"))):
        source = ROOT / name
        if name and source.is_file():
            target = copy / source.relative_to(ROOT)
            target.parent.mkdir(parents=True, exist_ok=True)
            if not target.exists() or target.read_bytes() != source.read_bytes():
                shutil.copy(source, target)
    settings = {
        "source_paths": ["so101_motion"],
        "only_mutate": [f"so101_motion/{room}/*.py" for room in rooms],
        "pytest_add_cli_args": ["-q", "-n", "0", "-p", "no:cacheprovider", "--reruns", "0"],
        "pytest_add_cli_args_test_selection": tests,
        "also_copy": [path.name for path in copy.iterdir() if path.name != "mutants"],
    }
    lines = [f"{key} = {json.dumps(value)}\n" for key, value in settings.items()]
    with (copy / "pyproject.toml").open("a") as file:
        file.writelines(["\n[tool.mutmut]\n", *lines])


def mutmut(copy: Path, names: list[str]) -> str:
    command = [sys.executable, "-m", "mutmut", "run", "--max-children", "2", *names]
    done = subprocess.run(command, cwd=copy, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    return done.stdout.decode(errors="replace")[-3000:]


def mutants_in(copy: Path, room: str) -> dict[str, tuple[str, int | None]]:
    """Of each mutant's name the mark of the function it changes, and how the tests ended."""
    found: dict[str, tuple[str, int | None]] = {}
    for meta in sorted((copy / "mutants/so101_motion" / room).glob("*.meta")):
        kept = json.loads(meta.read_text())
        for name, code in kept["exit_code_by_key"].items():
            function = name.rpartition("__mutmut_")[0].removeprefix(
                f"so101_motion.{room.replace('/', '.')}."
            )
            mark = kept["hash_by_function_name"].get(function.partition(".")[2], "")
            found[name] = (mark, code)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "--room", action="append", choices=ROOMS, help="this room alone, may be repeated"
    )
    parser.add_argument("--each", type=int, default=60, help="mutants a room")
    parser.add_argument("--seed", type=int, default=50)
    parser.add_argument("--again", type=Path, help="the same mutants as in this file")
    parser.add_argument("--survivors", action="store_true", help="of --again those that lived")
    parser.add_argument("--copy", type=Path, help="the copy of an earlier run, to go on with")
    parser.add_argument("--out", type=Path, default=Path("mutation.json"))
    asked = parser.parse_args()
    rooms = asked.room or list(ROOMS)
    copy = asked.copy or Path(tempfile.mkdtemp(prefix="mutation-"))
    copy_of_the_tree(copy, rooms, tests_of(rooms, asked.survivors))
    said = mutmut(copy, ["nothing"])  # makes the mutants, and says that no name fits
    before = json.loads(asked.again.read_text()) if asked.again else {}
    chosen: list[str] = []
    for room in rooms:
        there = mutants_in(copy, room)
        if not there:
            print(said)
            return 1
        if asked.again:
            chosen += [
                name
                for name, was in before[room].items()
                if there.get(name, ("gone",))[0] == was["function"]
                and not (asked.survivors and was["ended"] in ("killed", "timeout"))
            ]
        else:
            chosen += random.Random(asked.seed).sample(sorted(there), min(asked.each, len(there)))
    said = mutmut(copy, chosen)
    result = {}
    for room in rooms:
        there = mutants_in(copy, room)
        result[room] = {
            name: {"function": there[name][0], "ended": KILLED.get(there[name][1] or 0, "timeout")}
            for name in chosen
            if name in there and there[name][1] is not None
        }
        count = Counter(each["ended"] for each in result[room].values())
        print(f"{room}: {len(result[room])} tried, {dict(count)}")
        for name, each in result[room].items():
            if each["ended"] in ("survived", "no test"):
                print("  ", each["ended"], name)
    if not any(result.values()):
        print(said)
        return 1
    asked.out.write_text(json.dumps(result, indent=1))
    print(f"kept in {asked.out}; mutmut show NAME in {copy} shows a mutant")
    return 0


if __name__ == "__main__":
    sys.exit(main())
