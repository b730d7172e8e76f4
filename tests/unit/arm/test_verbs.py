"""What somebody who guesses types: ``so101.open``, ``move``, ``follow`` in a ``with`` block."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import so101_motion as so101
from so101_motion.common.attributes import LoadConfig
from so101_motion.common.clock import ManualClock
from so101_motion.common.public import explained
from so101_motion.files.scene_file import read_scene
from so101_motion.files.trajectory_export import export
from so101_motion.planning.collision.scene import Tool
from so101_motion.planning.collision.shape_files import file_mesh
from so101_motion.tasks.jog_operation import JogOperation


@pytest.fixture
def rig():
    """A simulated arm whose time passes by itself."""
    clock, over = ManualClock(), threading.Event()

    def pass_time():
        while not over.wait(1e-4):
            clock.advance(0.02)

    with so101.open_simulated(clock=clock) as rig, ThreadPoolExecutor(1) as beside:
        beside.submit(pass_time)
        yield rig
        over.set()


def test_sim_opens_a_simulated_arm_that_moves_nothing():
    with so101.open("sim") as rig:
        assert rig.connection.is_simulated
        assert not rig.arm.is_moving
        np.testing.assert_array_equal(rig.arm.q, np.zeros(5))


@pytest.mark.parametrize("arm", ["sim", "viam://127.0.0.1:1"])
def test_a_calibration_is_refused_for_an_arm_on_no_port(arm):
    with pytest.raises(so101.errors.ConfigError, match=r"calibration.*serial port"):
        so101.open(arm, calibration="mine")


@pytest.mark.parametrize(
    ("calibration", "why"),
    [("nobodys", "nor is"), ("no/file", "not a file"), ("bad.json", "is not JSON")],
)
def test_a_calibration_that_is_nowhere_or_unreadable_is_refused_before_the_port_is_opened(
    calibration, why, tmp_path, monkeypatch
):
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    Path("bad.json").write_text("not json")
    with pytest.raises(so101.So101Error, match=why):
        so101.open(str(tmp_path / "port"), calibration=calibration)


def test_a_machine_that_cannot_be_reached_is_named():
    with pytest.raises(so101.errors.MachineUnavailable, match=r"127\.0\.0\.1:1"):
        so101.open("viam://127.0.0.1:1")


def test_move_waits_for_goals_plans_and_joint_angles(rig):
    rig.arm.move(so101.point(0.25, 0.12, 0.15))
    np.testing.assert_allclose(rig.arm.T_base_tool.p, [0.25, 0.12, 0.15], atol=1e-3)
    plan = rig.arm.plan(so101.JointGoal(q=np.full(5, 0.2)))
    rig.arm.move(plan)
    np.testing.assert_allclose(rig.arm.q, np.full(5, 0.2), atol=1e-3)
    rig.arm.move([0.0, -0.5, 0.5, 0.0, 0.0])
    np.testing.assert_allclose(rig.arm.q, [0.0, -0.5, 0.5, 0.0, 0.0], atol=1e-3)


def test_a_motion_is_under_way_from_when_it_was_asked_for(rig):
    motion = rig.arm.move([0.2, 0, 0, 0, 0], wait=False)
    assert rig.arm.is_moving, "it is still being planned"
    with pytest.raises(TimeoutError, match="under way after 0 s"):
        motion.result(0)
    motion.result()
    assert not rig.arm.is_moving
    motion = rig.gripper.open(wait=False)
    assert rig.gripper.is_moving
    motion.result()
    assert not rig.gripper.is_moving


def test_a_plan_is_refused_when_what_it_was_made_for_has_changed(rig):
    arm, before = rig.arm, rig.arm.scene
    T = so101.SE3.from_translation((0.25, 0.12, 0.15))
    crate = so101.Obstacle(name="crate", shape=so101.Box(size=[0.05] * 3), T_base_obstacle=T)
    pole = so101.Attached(
        name="pole", shape=so101.Box(size=[0.01, 0.01, 0.6]), T_tool_object=so101.SE3.identity()
    )
    plan = arm.plan(so101.point(0.25, 0.12, 0.15))
    another_arms = replace(plan)
    for given, change, why in (
        (plan, lambda: setattr(arm, "scene", so101.Scene(obstacles=(crate,))), "'crate'; plan aga"),
        (another_arms, lambda: None, "'crate'; plan again"),
        (plan, lambda: arm.set_tool(Tool(name="pole", parts=(pole,), frames={})), "'pole'"),
        (plan, lambda: arm.set_load(LoadConfig(mass=3.0)), "3000 g"),
        (plan, lambda: arm.set_speed(0.2), "its limit is 11.459"),
    ):
        change()
        with pytest.raises(so101.errors.PlanningError, match=why):
            arm.move(given)
        arm.set_tool(None)
        arm.scene = before if given is another_arms else arm.scene
    assert arm.state.q_ref.tolist() == [0.0] * 5
    arm.set_load(LoadConfig())
    arm.set_speed(1.0)
    arm.move(another_arms)


def test_limits_of_a_finished_plan_and_three_angles_are_refused(rig):
    plan = rig.arm.plan([0.1] * 5)
    caps = so101.MotionLimits.uniform(velocity=1.0, acceleration=1.0, jerk=9.0)
    with pytest.raises(so101.errors.ConfigError, match=r"limits.*this plan is already made"):
        rig.arm.move(plan, limits=caps)
    with pytest.raises(so101.errors.ConfigError, match="5 joint angles in radians; these are 3"):
        rig.arm.move([0.1, 0.2, 0.3])


def test_degrees_millimetres_percent_and_other_mistakes_are_asked_about(rig):
    at, arm, caps = so101.SE3.from_translation, rig.arm, so101.MotionLimits.uniform
    cell = so101.Cell()
    cell.add("a", rig, np.eye(4))  # the matrix of a pose will do
    doors = {
        "did you mean .sim.": lambda: so101.open("simulated"),
        "viam://HOST:PORT": lambda: so101.open("viam:/host"),
        "name that LeRobot knows": lambda: so101.open("/dev/ttyACM0", calibration=3),
        "how much of the pose counts": lambda: arm.move(at([0.2, 0.0, 0.1])),
        "an SE3 or its matrix": lambda: so101.PoseGoal(T_base_tool=(0.2, 0.0, 0.1)),
        "orthonormal": lambda: so101.LineTo(T_base_tool=-np.eye(4)),
        "LineTo and ArcTo": lambda: so101.ToolPathGoal(segments=(at([0.2, 0.0, 0.1]),)),
        "4 numbers, a quaternion": lambda: so101.SE3.from_quaternion((1, 0, 0)),
        "True or False": lambda: arm.set_torque("off"),
        "must be .*JointCaps": lambda: arm.set_ceiling(3),
        "is 286.5 deg/s": lambda: arm.set_speed(5),
        "of 6 joints instead of 5": lambda: arm.plan(
            [0] * 5, limits=caps(velocity=1, acceleration=1, jerk=9, n=6)
        ),
        "in this cell already": lambda: cell.add("b", rig, np.eye(4)),
        "^.item. = .mug.: the scene is empty; .* a mass in kg": lambda: rig.pick("mug"),
        "^.at_end. = .Hold.: .* hold, release, home, park": lambda: setattr(rig, "at_end", "Hold"),
        "must be .*Wishes": lambda: rig.pick("mug", wishes="above"),
        "must be PlanRequests": lambda: so101.PlanningWorker().plan_many([3]),
        "what so101.open returns": lambda: so101.middles_of(arm),
        "list of .*TimedPoint": lambda: arm.stream().push([[0] * 5]),
        "60 rad: did you mean degrees": lambda: arm.plan([0, -45, 45, 60, 0]),
        "90 rad: did you mean degrees": lambda: so101.PathGoal(waypoints=[[0, 0, 90, 0, 0]]),
        "-45 rad: did you mean degrees": lambda: arm.retarget([0, -45, 0, 0, 0]),
        "10 rad: did you mean degrees": lambda: arm.plan([0] * 5, q_start=[0, 10, 0, 0, 0]),
        "30 rad/s: did you mean degrees": lambda: caps(velocity=30, acceleration=60, jerk=600),
        "20 rad/s: did you mean degrees": lambda: arm.set_speed(20),
        "90 rad: did you mean degrees[?] 90 deg is": lambda: so101.SE3.from_rpy((0, 90, 0)),
        "50 % is 0.5": lambda: rig.gripper.move(50),
        "number from 0": lambda: rig.gripper.move("open"),
        "must be a Tool": lambda: arm.set_tool("pen"),
        "a serial port": lambda: so101.open(3),
        "pose is so101.SavedPoses": lambda: arm.move("ready"),
        "30 rad: did you mean degrees[?] 30 deg": lambda: arm.follow().aim([30, 0, 0, 30, 0]),
        "60 % is 0.6": lambda: rig.gripper.follow().aim(60),
        "must be a so101.Payload": lambda: arm.set_payload(0.1),
        "must be MotionLimits": lambda: arm.plan([0] * 5, limits={"velocity": 1}),
        "MotionLimits.uniform": lambda: rig.gripper.move(0.5, limits={"velocity": 1}),
        "must be a number .rad/s.": lambda: arm.set_speed("fast"),
        "give the bytes": lambda: file_mesh("stl", Path("part.stl")),
        "2 x 3; of several points": lambda: arm.plan([[0.2, 0, 0.1], [0.25, 0, 0.1]]),
        "2 x 5; .* rows of angles a PathGoal": lambda: arm.plan(np.zeros((2, 5))),
        "different lengths; of several": lambda: arm.plan([[0.0] * 5, [0.0]]),
        "these are 6; the jaw": lambda: arm.plan([0.0] * 6),
        "in radians$": lambda: arm.plan(["a"] * 5),
        "^.guard. = False: must be .scene., or None": lambda: arm.follow(guard=False),
        "^.guard. = .off.: must be .scene.": lambda: arm.stream(guard="off"),
        "radians, or a goal such as": lambda: arm.plan(np.array(0.3)),
        "250 m: did you mean millimetres": lambda: so101.point(250, 120, 150),
        "40 m: did you mean millimetres": lambda: so101.ApproachGoal(
            T_base_tool=at([0.2, 0.0, 0.1]), hover=[0, 0, 40]
        ),
        "300 m/s: did you mean millimetres": lambda: arm.jog().twist([0, 300, 0]),
        "350 m: did you mean millimetres": lambda: so101.Cell().add("b", rig, at([350, 0, 0])),
        "40 m: did you mean millimetres[?] 40 mm": lambda: so101.Box(size=[40] * 3),
        "30 m: did you mean millimetres": lambda: so101.Sphere(radius=30),
        "is more than 5 kg: did you mean grams[?] 30 g is 0.03 kg": lambda: so101.Obstacle(
            name="cup", shape=so101.Sphere(radius=0.02), T_base_obstacle=at([0.2, 0, 0]), mass=30
        ),
        "the name of an item": lambda: rig.pick(None),
        "^.y. = .*must be a number": lambda: so101.point(0.2, "1", 0.1),
        "^.x.: must be a number": lambda: so101.point(None, 0.1, 0.1),
        "200 m: did you mean millimetres": lambda: so101.Box(size=(200, 30, 30)),
        "^.limits.: are needed": lambda: so101.PlanRequest(
            q_start=[0] * 5, goal=so101.point(0.2, 0, 0.1), limits=None
        ),
        "^.mesh. = .8 bytes.: is not a stl": lambda: file_mesh(".stl", b"nonsense"),
        "300 m: did you mean millimetres": lambda: at((300, 0, 10)),
        "such as so101.point": lambda: arm.move(None),
        "must be finite angles": lambda: arm.move([np.nan] * 5),
        "to 3.14 rad/s": lambda: arm.set_speed(-1),
        "must be a plan, its trajectory": lambda: export(arm, "move.csv"),
        "^.pose.: is not a pose; known: home": lambda: so101.SavedPoses().find(None),
        "5 joint angles .* these are 4": lambda: so101.SavedPoses().save("x", [0.0] * 4),
        "^.scene. = .nowhere.json.: cannot be read": lambda: read_scene("nowhere.json"),
        "80 m: did you mean millimetres": lambda: so101.Attached(
            name="pen", shape=so101.Sphere(radius=0.01), T_tool_object=at([0, 0, 80])
        ),
    }
    for question, ask in doors.items():
        with pytest.raises(so101.errors.ConfigError, match=question):
            ask()


def test_a_call_with_wrong_arguments_says_what_to_write(rig):
    arm, goal = rig.arm, so101.point(0.25, 0.12, 0.15)
    for meant, ask in (
        (r"'speed'; .*set_speed.*limits=arm.limits.eased\(0.5\)", lambda: arm.move(goal, speed=1)),
        ("'velocity'; .*set_speed", lambda: arm.home(velocity=1)),
        ("it takes goal, limits, search, q_start", lambda: arm.plan(goal, block=True)),
        (r"it takes to, .*wait; a point is so101.point", lambda: arm.move(0.25, 0.12, 0.15)),
        (r"of an array p: point\(\*p\)", lambda: so101.point([0.25, 0.12, 0.15])),
        (r"write JointGoal\(q=\.\.\.\)", lambda: so101.JointGoal([0.0] * 5)),
        (r"'diameter'; write Sphere\(radius=", lambda: so101.Sphere(diameter=0.1)),
        (r"half open is move\(0.5\)", lambda: rig.gripper.open(0.5)),
    ):
        with pytest.raises(TypeError, match=meant):
            ask()
    with pytest.raises(TypeError, match=r"^from within$"):
        explained("not this")(lambda: _raise(TypeError("from within")))()
    assert arm.plan(goal, limits=arm.limits.eased(0.5)).duration > arm.plan(goal).duration
    with pytest.raises(AttributeError, match=r"it is so101_motion.errors.NoPath"):
        _ = so101.NoPath


def _raise(error):
    raise error


def test_keys_move_the_tool_in_steps(rig):
    jogging, (x, y, z) = JogOperation(rig), rig.arm.T_base_tool.p
    jogging.ask("go", z=-20.0)
    jogging.ask("go", y=10.0)
    while np.abs(rig.arm.T_base_tool.p - (x, y + 0.01, z - 0.02)).max() > 5e-4:
        assert not jogging.view.trouble
    assert [each.arguments["x"] for each in jogging.view.offers if each.title == "ahead"] == [10.0]
    jogging.ask("step")
    assert [each.arguments["x"] for each in jogging.view.offers if each.title == "back"] == [-50.0]
    for _ in range(3):
        jogging.ask("go", x=50.0)
    while "held back by the end of its reach" not in jogging.view.trouble:
        assert rig.arm.T_base_tool.p[0] < x + 0.14
    jogging.close()
    assert not rig.arm.state.arm_moving


def test_a_key_stops_the_tool_on_its_way(monkeypatch):
    clock = ManualClock()  # passes only where this test says so
    with so101.open_simulated(clock=clock) as rig, ThreadPoolExecutor(1) as beside:
        start_stop = rig.arm.start_stop

        def time_passes_from_then_on():
            stopped = start_stop()
            beside.submit(clock.advance, 1.0)
            return stopped

        monkeypatch.setattr(rig.arm, "start_stop", time_passes_from_then_on)
        jogging, z = JogOperation(rig), rig.arm.T_base_tool.p[2]
        jogging.ask("go", z=-50.0)
        while rig.arm.T_base_tool.p[2] > z - 0.005:
            clock.advance(0.02)
        jogging.ask("stop")
        assert z - 0.045 < rig.arm.T_base_tool.p[2] < z - 0.005  # not where it was sent


def test_keys_go_on_after_the_arm_let_go_or_another_motion_took_over(rig):
    jogging = JogOperation(rig)
    rig.arm.move([0.1] * 5)
    z = rig.arm.T_base_tool.p[2]
    jogging.ask("go", z=-10.0)
    while rig.arm.T_base_tool.p[2] > z - 0.009:
        assert not jogging.view.trouble
    rig.arm.set_torque(False)
    assert [each.command for each in jogging.view.offers] == ["hold"]
    jogging.ask("hold")
    assert jogging.view.state == "jogging"
    jogging.close()


def test_a_prompt_shows_what_there_is(rig):
    plan = rig.arm.plan(so101.point(0.25, 0.12, 0.15))
    lines = str(plan).splitlines()
    assert " ".join(line.split()[0] for line in lines) == "duration length clearance caps tool"
    assert "156 mm of the tool" in lines[1]
    assert lines[4].endswith("to (250.0, 120.0, 150.0) mm")
    assert plan._repr_html_().count("<svg") == 2
    assert {"move", "home", "plan", "stop"} <= set(dir(rig.arm))
    assert {"open", "close", "grab"} <= set(dir(rig.gripper))
    assert {"arm", "gripper"} <= set(dir(rig))
    assert "simulated arm" in repr(rig)
    goal = so101.point(0.25, 0.12, 0.15)
    at = "<SE3 at (0.25, 0.12, 0.15) m, rpy (0.0, 0.0, 0.0) deg>"
    assert (repr(goal), repr(so101.Scene())) == (f"PoseGoal(T_base_tool={at})", "Scene()")
    caps = so101.MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=9.0, tool_speed=0.05)
    words = "velocity 1.0 rad/s, acceleration 2.0 rad/s^2, jerk 9.0 rad/s^3, tool_speed 0.05 m/s"
    assert (repr(caps), repr(so101.Cell())) == (f"<MotionLimits: {words}>", "<Cell of no arms>")
    with rig.arm.follow() as following:
        following.aim([0.0, 0.0, 0.0, 0.0, 0.1])
        assert repr(following) == "<Following to (0.0, 0.0, 0.0, 0.0, 5.7) deg>"
    assert repr(following) == "<Following over>"
    assert repr(plan.report).startswith("PlanReport(straight=True, departure=False, clearance=0.0")
    for shown in (plan, plan.trajectory, plan.report, rig, rig.arm, rig.gripper):
        assert not [name for name in dir(shown) if name.startswith("_")]


def test_a_misspelt_attribute_is_refused_with_the_name_that_was_meant(rig):
    rig.arm.scene = so101.Scene()
    for held, name, meant in (
        (rig.arm, "sceen", "scene"),
        (rig.gripper, "limit", "limits"),
        (rig, "at_ends", "at_end"),
        (so101.Cell(), "member", "members"),
    ):
        with pytest.raises(AttributeError, match=f'no .{name}.; did you mean "{meant}"'):
            setattr(held, name, None)
    with pytest.raises(AttributeError, match=r'no .homer.; did you mean "home".*known: T_base'):
        rig.arm.homer()
    with pytest.raises(AttributeError, match=r"set_speed\(\.\.\.\) sets it"):
        rig.arm.speed = 1.0


def test_a_closed_arm_says_so_whatever_it_is_asked(rig):
    arm, jaw, following, jaw_following = (
        rig.arm,
        rig.gripper,
        rig.arm.follow(),
        rig.gripper.follow(),
    )
    rig.close()
    for ask in (
        lambda: arm.plan([0.1] * 5),
        lambda: arm.move([0.1] * 5),
        lambda: arm.q,
        lambda: arm.T_base_tool,
        arm.T_base_links,
        arm.touching,
        lambda: jaw.aperture,
        lambda: jaw.is_holding,
        lambda: following.aim([0.0] * 5),
        lambda: jaw.open(),
        lambda: jaw_following.aim(0.5),
    ):
        with pytest.raises(so101.errors.ArmClosed, match="open it again"):
            ask()
    assert repr(arm) == "<Arm closed>"
    assert repr(jaw) == "<Gripper of a closed arm>"


@pytest.mark.parametrize("opened", ["follow", "jog", "stream"])
def test_leaving_the_block_brings_the_arm_to_rest(rig, opened):
    with getattr(rig.arm, opened)() as source:
        if opened == "follow":
            source.aim([0.3, -0.3, 0.3, 0.0, 0.0])
    assert source.future.done()
    assert not rig.arm.state.arm_moving


def test_an_error_in_the_block_is_the_one_that_is_raised(rig):
    with pytest.raises(ZeroDivisionError), rig.arm.follow() as following:
        following.aim([0.0, 0.0, 0.0, 0.0, 1 / 0])
    assert following.future.done()


def test_a_following_that_was_ended_earlier_raises_why(rig):
    with pytest.raises(so101.errors.Interrupted), rig.arm.follow():
        rig.arm.stop()


def test_the_names_are_shown(rig):
    assert {"keep_off", "start_stream", "tool"} <= set(dir(rig.arm))
    assert {"open", "point", "errors", "PoseGoal"} <= set(dir(so101))
