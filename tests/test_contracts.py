"""Imports go in the right direction only and load little; every benchmark answers `--help`."""

import subprocess
import sys
from pathlib import Path

import pytest


def test_imports_follow_the_contracts():
    # In a process of its own: import-linter switches off every logger it finds.
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[1])
    assert result.returncode == 0, result.stdout


PLANS = (
    "from so101_motion.planning.planner import Planner\n"
    "from so101_motion.planning.kinematics.model import RobotModel\n"
    "Planner(RobotModel.load()).warm_up()"
)


@pytest.mark.parametrize(
    ("program", "unwanted"),
    [
        ("import so101_motion.control.executor", "pinocchio toppra viam scipy matplotlib"),
        ("import so101_motion.planning.differential.servo", "osqp scipy"),
        (PLANS, "toppra matplotlib"),
    ],
    ids=["the control loop", "before the first servo", "planning"],
)
def test_what_is_not_needed_is_not_loaded(program, unwanted):
    look = f"{program}\nimport sys; print(*(set(sys.modules) & set({unwanted.split()})))"
    done = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


def test_every_benchmark_answers_help_instead_of_starting():
    benchmarks = (Path(__file__).parents[1] / "benchmarks").glob("bench_*.py")
    assert not [each.name for each in benchmarks if "parse_args()" not in each.read_text()]
