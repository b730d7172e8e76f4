import math

import pytest

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import ConfigError
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import parse_fault
from so101_motion.drivers.emulator.hand import Hand, Waypoint, jaw_angle_for_gap, parse_script
from so101_motion.planning.kinematics.model import RobotModel

SCRIPT = """
# time  joint          angle
1.0     shoulder_pan   start
3.0     shoulder_pan   -40
3.5     shoulder_pan   release   # lets go
2.0     gripper        30
"""


def test_script_is_read_line_by_line_in_order_of_time():
    assert parse_script(SCRIPT) == (
        Waypoint(t=1.0, joint="shoulder_pan"),
        Waypoint(t=2.0, joint="gripper", q=math.radians(30)),
        Waypoint(t=3.0, joint="shoulder_pan", q=math.radians(-40)),
        Waypoint(t=3.5, joint="shoulder_pan", release=True),
    )


@pytest.mark.parametrize(
    "line", ["1.0 shoulder_pan", "x shoulder_pan 3", "1 knee 3", "1 gripper y"]
)
def test_bad_line_is_refused_by_number(line):
    with pytest.raises(ConfigError, match="line 2"):
        parse_script("\n" + line)


def test_hand_leads_a_limp_joint_along_its_script(bench):
    bench.world.hand = Hand(parse_script(SCRIPT))
    bench.advance(1.0)
    assert bench.world.q[0] == pytest.approx(0.0, abs=1e-9)
    bench.advance(1.0)
    assert bench.world.q[0] == pytest.approx(math.radians(-20), abs=math.radians(3))
    bench.advance(1.4)
    assert bench.world.q[0] == pytest.approx(math.radians(-40), abs=math.radians(1))
    assert bench.read(1, reg.PRESENT_POSITION) < 1620
    bench.advance(5.0)
    assert bench.world.q[0] == pytest.approx(math.radians(-40), abs=math.radians(1))


def test_hand_gives_in_at_a_stop_and_cannot_overpower_a_servo_that_holds(bench):
    bench.write(1, reg.TORQUE_ENABLE, 1)
    bench.world.hand = Hand(parse_script(SCRIPT + "0 elbow_flex start\n1 elbow_flex 160"))
    bench.advance(3.4)
    assert abs(bench.world.q[0]) < math.radians(15)
    assert math.degrees(bench.world.q[2]) == pytest.approx(90.8, abs=2.0)


def test_jaw_angle_follows_the_table_of_gaps():
    assert math.degrees(jaw_angle_for_gap(0.0)) == pytest.approx(-11.5)
    assert math.degrees(jaw_angle_for_gap(0.0158)) == pytest.approx(0.0)
    assert math.degrees(jaw_angle_for_gap(0.0253)) == pytest.approx(7.5)
    with pytest.raises(ConfigError, match="object"):
        jaw_angle_for_gap(0.2)


# Handling a kit: plugging servos in, holding the arm up, leading its joints


@pytest.fixture
def make_kit():
    made = []

    def make(**options):
        clock = ManualClock()
        weight = RobotModel.load().gravity_torque
        made.append(Emulator(EmulatorOptions(**options), now=clock.now, gravity=weight))
        return made[-1], clock

    yield make
    for kit in made:
        kit.close()


def pass_time(kit, clock, seconds):
    for _ in range(round(seconds / 0.1)):
        clock.advance(0.1)
        kit.advance()


def plugged_in(kit):
    return [servo.joint.name for servo in kit.world.servos if servo.connected]


def test_one_servo_alone_is_plugged_in_and_in_the_end_all(make_kit):
    kit, _ = make_kit(loose=True)
    kit.begin(parse_fault("only:gripper"))
    assert plugged_in(kit) == ["gripper"]
    kit.begin(parse_fault("only:5"))
    assert plugged_in(kit) == ["wrist_roll"]
    kit.begin(parse_fault("chain"))
    assert len(plugged_in(kit)) == 6
    kit.end(parse_fault("chain"))
    assert plugged_in(kit) == []


def test_a_hand_holds_a_limp_arm_up_until_it_lets_go(make_kit):
    kit, clock = make_kit()
    pass_time(kit, clock, 2.0)
    assert max(abs(kit.world.q)) > 0.5, "it has sunk"
    kit.begin(parse_fault("pose"))
    pass_time(kit, clock, 2.0)
    assert max(abs(kit.world.q)) < math.radians(4.0)
    kit.end(parse_fault("pose"))
    pass_time(kit, clock, 2.0)
    assert max(abs(kit.world.q)) > 0.5, "it has sunk again"


@pytest.mark.parametrize(("fault", "seconds"), [("sweep", 29.0), ("sweep=240", 18.0)])
def test_a_hand_leads_every_joint_to_both_its_stops(make_kit, fault, seconds):
    kit, clock = make_kit()
    kit.begin(parse_fault(fault))
    seen = {servo.joint.name: [math.inf, -math.inf] for servo in kit.world.servos}
    for _ in range(round(seconds / 0.05)):
        clock.advance(0.05)
        kit.advance()
        for servo in kit.world.servos:
            ends = seen[servo.joint.name]
            ends[:] = min(ends[0], servo.drive.q), max(ends[1], servo.drive.q)
    for servo in kit.world.servos:
        stops = (servo.joint.lower, servo.joint.upper)
        assert seen[servo.joint.name] == pytest.approx(stops, abs=math.radians(1.0))
