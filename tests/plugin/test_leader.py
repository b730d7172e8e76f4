"""The leader as a teleoperator of LeRobot: limp while it leads, driven to where a follower is."""

import numpy as np
import pytest
from harness.emulated_rig import MIDDLES_DEG
from harness.lerobot_bench import (
    READY,
    LeRobotBench,
    SO101MotionLeader,
    SO101MotionLeaderConfig,
    action,
)

from so101_motion.common.errors import ConfigError
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.emulator import registers as emu
from so101_motion.drivers.emulator.hand import Hand, parse_script

START = (*np.radians(np.add(READY[:5], MIDDLES_DEG)), 0.5)
HINT = 0.1  # of full drive


@pytest.fixture
def leader(folded):
    leader = folded.robot(SO101MotionLeader, SO101MotionLeaderConfig)
    leader.connect(calibrate=False)
    folded.advance(0.3)
    return leader


def values(leader):
    return np.array([leader.get_action()[key] for key in leader.action_features])


def test_its_joints_are_limp_it_says_where_they_are_and_it_is_left_as_it_is(folded, leader):
    assert not any(servo.drive.torque for servo in folded.world.servos)
    true = folded.q_deg[1] - folded.arm_deg(folded.open())[1]
    assert leader.get_action()["shoulder_lift.pos"] == pytest.approx(folded.q_deg[1] - true, abs=1)
    assert leader.feedback_features == leader.action_features
    leader.enable_torque()
    leader.disconnect()
    assert folded.world.servo("shoulder_lift").drive.torque
    assert not leader.is_connected


def test_feedback_drives_it_while_its_torque_is_on_and_not_otherwise(folded, leader):
    here = values(leader)
    leader.send_feedback(action(*READY))
    folded.advance(0.5)
    assert np.abs(values(leader) - here).max() < 1.0
    leader.enable_torque()
    for share in np.linspace(0.0, 1.0, 60):
        leader.send_feedback(action(*(here + share * (READY - here))))
        folded.advance(1.0 / 30.0)
    folded.advance(0.5)
    assert np.abs(values(leader) - READY)[:5].max() < 1.0
    leader.disable_torque()
    assert not any(servo.drive.torque for servo in folded.world.servos)


# The guard's hint


class Pair:
    """A hand that leads one arm, and a follower that keeps off the table; one clock for both."""

    def __init__(self, folder, **leader):
        for name in ("follower", "leader"):
            (folder / name).mkdir()
        self.follower = LeRobotBench(folder / "follower", q_start=START)
        self.leading = LeRobotBench(folder / "leader", clock=self.follower.clock, q_start=START)
        self.hand(0.0, 0.0)
        self.robot = self.follower.connected()
        self.leader = self.leading.robot(SO101MotionLeader, SO101MotionLeaderConfig, **leader)
        self.leader.connect(calibrate=False)

    def hand(self, lift, seconds):
        """Hold all joints; lead the shoulder on by ``lift`` [deg] within so many seconds."""
        there = self.leading.q_deg[1] + lift
        lines = [f"0 {joint} start" for joint in ARM_JOINTS]
        script = "\n".join([*lines, f"{max(seconds, 0.01)} shoulder_lift {there}"])
        self.leading.world.hand = Hand(parse_script(script), self.leading.clock.now())

    def teleoperate(self, seconds):
        """What LeRobot does; which share of their drive the leader's servos might use [0.1 %]."""
        shares = []
        for _ in range(round(50 * seconds)):
            self.robot.send_action(self.leader.get_action())
            self.leading.advance(0.02)
            shares.append(self.shares())
        return np.array(shares)

    def shares(self):
        driven = [servo.drive.torque for servo in self.leading.world.servos]
        return [torque * limit for torque, limit in zip(driven, self.limits, strict=True)]

    @property
    def limits(self):
        """Torque limits of the leader's servos [0.1 %]."""
        return [servo.memory.raw(emu.TORQUE_LIMIT) for servo in self.leading.world.servos]

    @property
    def lifts(self):
        """The shoulders of both [deg], the leader's first."""
        return [bench.q_deg[1] for bench in (self.leading, self.follower)]

    def close(self):
        self.leading.close()
        self.follower.close()


@pytest.fixture
def pair(tmp_path, request):
    pair = Pair(tmp_path, **getattr(request, "param", {"guard_hint": HINT}))
    yield pair
    pair.close()


@pytest.mark.parametrize("pair", [{}], indirect=True)
def test_unless_asked_for_no_torque_ever_comes_on(pair):
    pair.hand(50.0, 0.6)
    assert not pair.teleoperate(0.9).any()
    assert pair.lifts[0] - pair.lifts[1] > 5.0, "the guard holds the follower"


def test_a_held_follower_is_felt_until_nobody_asks_and_the_hand_still_leads(pair):
    assert not pair.teleoperate(0.1).any(), "while nothing is in the way it is limp"
    before = pair.lifts[0]
    pair.hand(50.0, 0.6)
    shares = pair.teleoperate(0.9)
    assert shares[-1].tolist() == [1000 * HINT] * 5 + [0], "the jaw stays limp"
    assert shares.max() == 1000 * HINT, "not for a moment more"
    assert pair.leading.rig.arm.state.mode is Mode.LIMP
    assert pair.lifts[0] - before > 30.0, "the hand gets its way"
    pair.leading.advance(0.3)
    assert not any(pair.shares()), "it ends by itself"
    assert pair.limits[:5] == [1000] * 5


def test_more_than_a_hint_is_refused(folded):
    with pytest.raises(ConfigError, match="guard_hint"):
        folded.robot(SO101MotionLeader, SO101MotionLeaderConfig, guard_hint=0.5)
