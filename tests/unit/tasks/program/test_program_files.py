import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.files.user_storage import LARGEST
from so101_motion.tasks.program import Loop, Program, Waypoint, files
from so101_motion.tasks.program.program import MOST

PROGRAM = Program.of_waypoints(
    (
        Waypoint(name="over the <mug>", q=np.radians([10, -40, 35, 60, 0]), aperture=0.8),
        Waypoint(name="at the mug", q=np.radians([10, -20, 30, 70, 0]), aperture=0.0, pause=0.5),
        Waypoint(name="über", q=np.zeros(5), speed=0.4),
        Waypoint(name="aside", q=np.zeros(5), passes=True),
        Waypoint(name="take", q=np.zeros(5), item="cube"),
        Waypoint(name="put", q=np.zeros(5), item="cube", place="200,120,0"),
    ),
    rounds=3,
    loops=(Loop(first=0, last=2, times=5), Loop(first=1, last=1, times=2)),
)


@pytest.fixture(autouse=True)
def data(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return tmp_path / "so101_motion" / "programs"


def told(each):
    return (each.name, each.aperture, each.pause, each.passes, each.speed, each.item, each.place)


@pytest.mark.parametrize("rounds", [1, 3, None])
def test_a_program_is_the_same_after_writing_and_reading(rounds):
    file = files.file_of("stack cubes")
    files.write(PROGRAM.with_rounds(rounds), file)
    again = files.read(file)
    assert [*map(told, again.waypoints)] == [*map(told, PROGRAM.waypoints)]
    assert (again.rounds, again.loops) == (rounds, PROGRAM.loops)
    for one, other in zip(again.waypoints, PROGRAM.waypoints, strict=True):
        np.testing.assert_allclose(one.q, other.q, atol=1e-6)


def test_programs_are_found_by_name_and_by_file(data, tmp_path):
    assert files.names() == ()
    files.write(PROGRAM, files.file_of("stack cubes"))
    files.write(PROGRAM, tmp_path / "other.json")
    assert files.names() == ("stack cubes",)
    assert files.find("stack cubes") == data / "stack cubes.json"
    assert files.find(str(tmp_path / "other.json")) == tmp_path / "other.json"
    with pytest.raises(ConfigError, match='did you mean "stack cubes"'):
        files.find("stack cube")
    files.delete("stack cubes")
    assert files.names() == ()
    with pytest.raises(ConfigError, match="cannot be removed"):
        files.delete("stack cubes")


def test_the_longest_program_of_four_arms_is_the_same_after_writing_and_reading(tmp_path):
    step = {arm: Waypoint(name="ü" * 40, q=np.full(5, 1.0 / 3.0), speed=0.5) for arm in "abcd"}
    files.write(Program(steps=(step,) * MOST), tmp_path / "long.json")
    assert (tmp_path / "long.json").stat().st_size > LARGEST
    assert len(files.read(tmp_path / "long.json")) == MOST


@pytest.mark.parametrize("name", ["../secret", ".hidden", "a/b", "a\\b", "", "x" * 41, "-rf"])
def test_a_name_that_leads_elsewhere_is_no_program(name):
    with pytest.raises(ConfigError, match="program name"):
        files.file_of(name)


def test_a_program_that_names_a_single_arm_runs_on_the_only_one_there_is(tmp_path):
    waypoint = Waypoint(name="a", q=np.zeros(5))
    files.write(Program(steps=({"left": waypoint},)), tmp_path / "wave.json")
    assert files.read(tmp_path / "wave.json").arms == ("left",)
    assert files.read(tmp_path / "wave.json", {"arm": None}).arms == ("arm",)
    assert files.read(tmp_path / "wave.json", {"left": None, "right": None}).arms == ("left",)
