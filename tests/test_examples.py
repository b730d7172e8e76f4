"""The examples do what they say, on the simulated arm."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from harness.clocks import PACED

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"

RUN = "from runpy import run_path; del sys.argv[0]; run_path(sys.argv[0], run_name='__main__')"

pytestmark = [pytest.mark.timeout(400)]  # they all run at once

ARGUMENTS = {
    "pick_and_place.py": [],
    "palletising.py": ["--rows", "1", "--columns", "1", "--speed", "180"],
    "plot_trajectory.py": ["trajectory.png", "--xyz", "200", "-100", "150"],
    "leader_follower.py": [],
    "reach_map.py": ["20"],
    "place_base.py": [],
    "motion_data.py": ["20"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("examples")


@pytest.fixture(scope="module")
def said(folder):
    """What an example prints, by its name. All run at once: most of their time they wait."""

    def start(name):
        return subprocess.Popen(
            [sys.executable, "-c", f"{PACED}{RUN}", str(EXAMPLES / name), *ARGUMENTS[name]],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    running = {name: start(name) for name in ARGUMENTS}

    def outcome(name):
        with running.pop(name) as example:
            try:
                out, err = example.communicate(timeout=300)
            finally:
                example.kill()
        assert example.returncode == 0, err
        return out

    yield outcome
    for process in running.values():
        process.kill()
        process.communicate()


def test_a_cube_is_carried_around_the_wall_over_grpc(said):
    lines = said("pick_and_place.py").splitlines()

    where = [line.strip() for line in lines if "tool at" in line]
    assert where[1] == "tool at (200.0, -140.0, 112.0) mm"
    assert where[4] == "tool at (200.0, 140.0, 112.0) mm"
    assert lines[-1] == "done"


def test_a_pallet_is_filled(said):
    lines = said("palletising.py")

    assert "jaw at (160.0, 140.0, 11.6) mm" in lines
    assert "jaw at (160.0, -160.0, 11.6) mm" in lines


def test_a_trajectory_becomes_a_picture(said, folder):
    assert "setpoints" in said("plot_trajectory.py")
    assert (folder / "trajectory.png").read_bytes().startswith(b"\x89PNG")


def test_the_follower_follows(said):
    off = [float(x) for x in re.findall(r"follower (\S+) deg off", said("leader_follower.py"))]
    assert len(off) == 3
    assert max(off) <= 0.2


def test_the_reach_is_drawn_as_far_left_as_right(said):
    rows = said("reach_map.py").splitlines()[1:]
    assert sum(len(row.strip(".")) > 10 for row in rows) > 5
    left, right = (
        sum(map(str.isdigit, "".join(row[part] for row in rows)))
        for part in (slice(0, 18), slice(19, 37))
    )
    assert 0.8 * left < right < 1.25 * left


def test_a_base_is_found(said):
    first = said("place_base.py").splitlines()[0]
    assert re.match(r"\(.*\) mm, .* deg: \d\.\d\d s once around", first)


def test_motions_are_made(said):
    made, first = said("motion_data.py").splitlines()
    assert "setpoints" in first
    assert made.startswith("{")
