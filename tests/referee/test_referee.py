"""The referee objects to every rule that is broken, and to nothing else."""

import math
from types import SimpleNamespace

import pytest

from referee.command import Command, CommandCaps
from referee.official import Caps, Referee
from referee.packets import Parser, Writes
from so101_motion.drivers.emulator.emulator import Emulator

TICK = 360.0 / 4096.0
CAPS = Caps(speed=50.0, acceleration=600.0)


def packet(servo_id, code, *params):
    body = bytes((servo_id, len(params) + 2, code, *params))
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def goal(servo_id, ticks):
    return packet(servo_id, 3, 42, ticks & 0xFF, ticks >> 8)


def goals(*ticks):
    shares = [byte for i, each in enumerate(ticks, 1) for byte in (i, each & 0xFF, each >> 8)]
    return packet(254, 0x83, 42, 2, *shares)


def torque(servo_id, on):
    return packet(servo_id, 3, 40, on)


class Pitch:
    """An emulated arm without a driver, under a referee of its own."""

    def __init__(self, emulator, clock):
        self.emulator, self.clock = emulator, clock
        self.referee = Referee()
        emulator.bus.observers.clear()
        self.match = self.referee.attend(emulator)
        self.match.ask_caps(lambda: (CAPS,) * 6)

    def say(self, data):
        self.emulator.bus.feed(data, self.clock.now())

    def at(self, place):
        return self.emulator.world.servo(place).drive.position

    def hold(self, *places):
        for place in places or range(1, 7):
            self.say(goal(place, self.at(place)))
            self.say(torque(place, 1))

    def lead(self, place, deg_per_s, seconds):
        """Send goals at a speed, a hundred times a second."""
        start = self.at(place)
        for k in range(round(seconds * 100)):
            self.say(goal(place, round(start + deg_per_s * 0.01 * k / TICK)))
            self.clock.advance(0.01)

    def wait(self, seconds):
        for _ in range(round(seconds * 100)):
            self.clock.advance(0.01)
            self.say(packet(1, 1))

    @property
    def broken(self):
        return {finding.rule for finding in self.referee.findings}


@pytest.fixture
def pitch(clock):
    with Emulator(now=clock.now) as emulator:
        yield Pitch(emulator, clock)


@pytest.fixture
def held(pitch):
    pitch.hold()
    pitch.wait(1.0)
    return pitch


# The wire


def jump(pitch):
    pitch.say(goal(4, 2048 + 512))


def race(pitch):
    pitch.lead(1, 170.0, 0.5)


def leave_the_limits(pitch):
    pitch.emulator.world.servo(1).memory.bytes[9:13] = bytes((0, 4, 0, 12))  # 1024 to 3072
    pitch.say(goal(1, 3073))


def drive_to_an_old_goal(pitch):
    pitch.say(torque(3, 0))
    pitch.wait(0.1)
    pitch.say(torque(3, 1))


def drive_without_a_goal(pitch):
    pitch.say(torque(3, 1))


def send_a_limp_one_away(pitch):
    pitch.say(goal(3, 2300))


def move_too_fast(pitch):
    pitch.say(goal(1, 2900))
    pitch.wait(0.6)


@pytest.mark.parametrize(
    ("is_held", "offend", "rule", "alone"),
    [
        (True, jump, "travel", True),
        (True, race, "travel", False),
        (True, move_too_fast, "motion", False),
        (False, leave_the_limits, "limits", False),
        (True, drive_to_an_old_goal, "seed", True),
        (False, drive_without_a_goal, "seed", True),
        (False, send_a_limp_one_away, "seed", True),
    ],
)
def test_what_breaks_a_rule_is_caught(pitch, is_held, offend, rule, alone):
    if is_held:
        pitch.hold()
        pitch.wait(1.0)
    offend(pitch)
    assert pitch.broken == {rule} if alone else rule in pitch.broken


def test_goals_of_a_sync_write_are_heard_by_each_servo(held):
    held.say(goals(2048, 2048, 2048, 2048, 2500, 2048))
    assert [finding.place for finding in held.referee.findings] == [5]


def test_a_goal_that_leaves_its_joint_behind_is_caught(held):
    servo = held.emulator.world.servo(1)
    servo.memory.bytes[48:50] = b"\0\0"  # no torque at all: it stays where it is
    held.say(packet(1, 3, 48, 0, 0))
    servo.drive.profile.target = servo.drive.position
    held.match.ask_caps(lambda: (Caps(170.0, 600.0),) * 6)
    servo.drive.powered = True
    stay = servo.drive.position
    for k in range(60):
        held.say(goal(1, 2048 + 18 * k))
        held.clock.advance(0.01)
        servo.drive.shaft.put(stay)
    assert "distance" in held.broken


def test_what_goes_on_after_a_stop_was_answered_is_caught(held):
    held.lead(2, 40.0, 0.5)
    held.match.stop_answered()
    held.lead(2, 40.0, 0.1)
    assert held.referee.findings == []  # that may be the ramp
    held.lead(2, 40.0, 0.5)
    assert held.broken == {"stop"}


def test_a_stop_says_nothing_of_a_joint_that_lost_its_power_and_fell(held):
    held.match.stop_answered()
    held.emulator.world.reboot(2)
    held.emulator.world.servo(2).drive.shaft.put(2700)
    held.wait(2.0)
    held.hold(2)
    held.wait(0.1)
    held.say(goal(2, 2701))
    assert held.referee.findings == []


def test_a_servo_that_protected_itself_is_where_its_goal_is_not_until_it_gets_another(held):
    world = held.emulator.world
    world.warm(3, 80.0)
    held.wait(1.0)
    world.servo(3).drive.shaft.put(3000)
    world.servo(3).drive.motor.temperature = 20.0
    world.cool(3)
    held.wait(2.0)
    assert world.servo(3).drive.guard.flags == 0
    assert held.referee.findings == []
    held.say(goal(3, 2048))  # where it was; the joint is not
    held.wait(0.02)
    assert "distance" in held.broken


# The joints


def test_a_joint_that_stops_while_nobody_writes_is_not_taken_for_one_that_jerks(held):
    held.match.ask_caps(lambda: (Caps(speed=200.0, acceleration=600.0),) * 6)
    there = held.at(1)
    for speed in [*range(0, 160, 4), *[160] * 20]:
        there += 0.01 * speed / TICK
        held.say(goal(1, round(there)))
        held.clock.advance(0.01)
    held.clock.advance(0.15)  # the cable is out
    held.wait(0.3)
    assert "motion" not in held.broken


def to_and_fro(pitch, ticks):
    """What the motion rule says of a pan whose servo takes it to and fro by itself."""
    pitch.hold()
    pitch.wait(1.0)
    pitch.match.ask_caps(lambda: (Caps(speed=180.0, acceleration=600.0),) * 6)
    middle, said = pitch.at(1), []
    for side in (1, -1) * 3:
        pitch.say(goal(1, middle + side * ticks))
        pitch.wait(0.4)
        said += [each.text for each in pitch.referee.findings if each.rule == "motion"]
        pitch.referee.findings.clear()  # the goals jump, too
    return said


def test_a_motor_that_crosses_its_play_as_hard_as_its_servo_does_alone_is_not_objected_to(pitch):
    pitch.say(packet(1, 3, 41, 64))  # it accelerates by up to 983 deg/s^2
    assert not to_and_fro(pitch, 400)


def test_a_set_point_that_is_harder_than_the_cap_is_caught_in_the_play_and_beyond_it(pitch):
    for register, units in ((85, 254), (41, 100)):
        pitch.say(packet(1, 3, register, units))  # it accelerates by 1,168 deg/s^2
    bounds = {round(float(text.split()[-2]), -1) for text in to_and_fro(pitch, 100)}
    assert bounds == {960.0, 1250.0}  # the supply sags a little under the motor


def test_a_joint_that_a_hand_pushes_is_nobody_s_fault(held):
    held.emulator.world.hand = SimpleNamespace(busy=True, torque=lambda *_: 4.0)
    held.wait(1.0)
    assert held.referee.findings == []


# The command


class Commanded:
    def __init__(self, caps=None):
        self.caps = caps or CommandCaps(50.0, 100.0, 1000.0)
        self.findings = []
        self.judge = Command(lambda rule, t, text: self.findings.append(text))
        self.t = 0.0

    def send(self, *angles, off_joint=10.0, after=0.01):
        for q in angles:
            self.t += after
            self.judge.sent(self.t, q, self.caps, off_joint)

    def rest(self):
        self.send(*[0.0] * 6)


def within_caps(n, jerk=1000.0, dt=0.01):
    """Angles of a command that begins with constant jerk."""
    q = qd = qdd = 0.0
    for _ in range(n):
        qdd += jerk * dt
        qd += qdd * dt
        q += qd * dt
        yield q


@pytest.mark.parametrize(
    ("caps", "angles", "after", "says"),
    [
        (None, [*within_caps(9, 1010.0), 0.0], 0.01, "jerk"),
        (CommandCaps(50.0, 100.0, 1e9), [0.0102, 0.0], 0.01, "acceleration 102 "),
        (CommandCaps(50.0, 1e9, 1e12), [0.51, 1.02, 1.53], 0.01, "speed 51 "),
        (None, [5.0, 5.0], 3.0, "speed"),  # after a pause
    ],
)
def test_a_command_beyond_its_caps_is_caught(caps, angles, after, says):
    commanded = Commanded(caps)
    commanded.rest()
    commanded.send(*angles, after=after)
    assert says in commanded.findings[0]


def test_a_command_at_its_caps_is_not_objected_to():
    commanded = Commanded()
    commanded.rest()
    commanded.send(*within_caps(10), 0.0)
    assert commanded.findings == []


@pytest.mark.parametrize(("off_joint", "findings"), [(0.4, 0), (1.2, 1)])
def test_a_command_may_go_to_where_its_joint_is_and_no_place_beside_it(off_joint, findings):
    commanded = Commanded()
    commanded.rest()
    commanded.send(5.0, off_joint=off_joint)
    commanded.send(*[5.0] * 5)
    assert len(commanded.findings) == findings


def elbow_of(pitch, goals=range(1, 7)):
    """What tells the judge of each joint that the elbow is commanded to an angle, as a record."""
    caps = CommandCaps(50.0, 100.0, 1000.0)
    sent = pitch.match.listen(lambda: (caps,) * 6, lambda i, q: 2048 + q * 4096.0 / math.tau)

    def say(t, q):
        sent(SimpleNamespace(t=t, q_cmd=(0.0, 0.0, q, 0.0, 0.0), q_jaw_cmd=0.0, is_guided=False,
                             is_seed=False, goals=goals))  # fmt: skip

    return say


@pytest.mark.parametrize(
    ("goals", "findings"),
    [(range(1, 7), [("command", 3)]), ((1, 2, 4, 5, 6), [])],  # silent servos are sent nothing
)
def test_the_record_of_an_arm_reaches_the_judge_of_each_joint(pitch, goals, findings):
    say = elbow_of(pitch, goals)
    for k, q in enumerate([0.0] * 5 + [0.2] * 2):
        say(0.01 * k, q)
    assert [(one.rule, one.place) for one in pitch.referee.findings] == findings


def test_what_is_commanded_after_the_process_was_stopped_begins_anew(pitch):
    say = elbow_of(pitch)
    for k in range(6):
        say(0.01 * k, 0.008 * k)  # at full speed
    pitch.match.paused()
    for k in range(6, 12):
        say(2.0 + 0.01 * k, 0.008 * k)
    assert pitch.referee.findings == []
    say(4.0, 0.1)
    say(4.01, 0.12)
    say(4.02, 0.14)
    assert pitch.broken == {"command"}


# Its tools


def test_packets_are_found_however_they_are_cut():
    data = b"\x00\xff" + goal(1, 2048) + b"\xff" + goals(1, 2, 3, 4, 5, 6) + b"\x12"
    whole = Parser().feed(data)
    parser = Parser()
    assert [one for byte in data for one in parser.feed(bytes((byte,)))] == whole
    assert [one.code for one in whole] == [3, 0x83]


def test_a_spoilt_packet_is_not_believed():
    spoilt = bytearray(goal(1, 2048))
    spoilt[-2] ^= 1
    assert Parser().feed(bytes(spoilt) + goal(2, 100))[0].servo_id == 2


def test_a_write_that_waits_counts_when_it_is_let_go():
    writes = Writes()
    assert writes.feed(packet(1, 4, 42, 0, 8)) == []
    (written,) = writes.feed(packet(254, 5))
    assert written.value(42, 2) == 2048
