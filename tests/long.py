"""``make test-long``: what takes long, or cannot bear a machine that stands still.

    .venv/bin/python tests/long.py                    # all parts, for hours
    .venv/bin/python tests/long.py laws --examples 60 # some of them, briefly

Each part writes its line in ``tests/LONG.md``: when it ran, with which seed, for how long, and what
came of it. It is run before an issue is called resolved, and the table is committed.
"""

import argparse
import re
import shlex
import shutil
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from random import SystemRandom

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "tests" / "LONG.md"
HEAD = """# The long tests, as they were last run

`make test-long` writes these lines; `make test-long PARTS="laws campaign"` runs some parts.
What each does: [README.md](README.md).

| part | begun (UTC) | commit | command | seed | took | result |
|---|---|---|---|---|---|---|
"""
PYTEST = f"{shlex.quote(sys.executable)} -m pytest -q -p no:cacheprovider"


def parts(seed, examples, attacks):
    """Every part's command, in the order in which they run."""
    return {
        "real-time": f"{PYTEST} -n 0 -m long --timeout 600",
        "laws": f"{PYTEST} -n 2 --dist worksteal -m 'hypothesis and not campaign' --timeout 7200"
        f" --hypothesis-seed {seed} --examples {examples}",
        "campaign": f"{PYTEST} -n 0 -m campaign --timeout 7200"
        f" --hypothesis-seed {seed} --examples {attacks}",
        "lerobot": "tests/genuine_lerobot/run.sh",
        "data-sets": "tests/genuine_lerobot/data_sets.sh",
        "tools": "tests/genuine_tools/run.sh",
        "machines": "python3 tests/machines/try_machines.py",
        "release": f"{shlex.quote(sys.executable)} tests/machines/try_release.py",
    }


def cannot_run(part):
    """Why a part cannot run here; None if it can."""
    if part == "machines" and not shutil.which("mmdebstrap"):
        return "left out: needs root on a Debian with mmdebstrap"
    return None


def run(part, command):
    """What came of a part: whether it passed, and its last words."""
    print(f"== {part}: {command}", flush=True)
    with subprocess.Popen(
        shlex.split(command), cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        last = ""
        for line in process.stdout:
            sys.stdout.write(line)
            last = line.strip(" =\n") or last
    last = re.sub(r" in [0-9.]+s.*", "", last).replace("|", "/").replace(f"{ROOT}/", "")
    return process.returncode, last[:160]


def main():
    """Run the parts that are asked for, and write the table anew."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("parts", nargs="*", metavar="PART", help=", ".join(parts(0, 0, 0)))
    asked.add_argument("--seed", type=int, default=SystemRandom().randrange(10**6))
    asked.add_argument("--examples", type=int, default=500, help="for each law")
    asked.add_argument("--attacks", type=int, default=50, help="of each kind, for the campaign")
    told = asked.parse_args()
    every = parts(told.seed, told.examples, told.attacks)
    if unknown := set(told.parts) - set(every):
        asked.error(f"no such part: {', '.join(sorted(unknown))}; there are {', '.join(every)}")
    before = TABLE.read_text().splitlines() if TABLE.exists() else []
    rows = {line.split("|")[1].strip(): line for line in before if line.startswith("| ")}
    failed = []
    for part in told.parts or every:
        command = every[part]
        begun, since = datetime.now(UTC), time.monotonic()
        code, words = (0, why) if (why := cannot_run(part)) else run(part, command)
        if code:
            failed.append(part)
        minutes, seconds = divmod(round(time.monotonic() - since), 60)
        commit = subprocess.check_output(("git", "rev-parse", "--short", "HEAD"), cwd=ROOT).decode()
        cells = (
            part,
            f"{begun:%Y-%m-%d %H:%M}",
            commit.strip(),
            f"`{command.replace(shlex.quote(sys.executable), 'python')}`",
            f"{told.seed}" if f"{told.seed}" in command else "",
            f"{minutes} min {seconds} s",
            ("" if code == 0 else f"**failed ({code})**: ") + words,
        )
        rows[part] = "| " + " | ".join(cells) + " |"
        TABLE.write_text(HEAD + "\n".join(rows[each] for each in every if each in rows) + "\n")
    sys.exit(f"failed: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
