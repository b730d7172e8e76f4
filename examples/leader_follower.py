"""One arm follows another, which a hand leads or, if both are simulated, a program.

    python examples/leader_follower.py
    python examples/leader_follower.py --leader /dev/ttyACM0 --follower /dev/ttyACM1

With ports, the leader goes limp so that you can lead it, and THE FOLLOWER MOVES: slowly until it
stands as the leader does, then with it. Ctrl-C ends it, and both hold.
"""

from __future__ import annotations

import argparse
import contextlib
import time

import numpy as np

import so101_motion as so101
from so101_motion.common.units import to_deg, to_rad
from so101_motion.drivers.bus.defaults import GRIPPER_ID, SERVO_IDS
from so101_motion.tasks.teleop import LocalArm, LocalFollower, LocalLeader, Teleop
from so101_motion.tasks.teleop.pilot import Phase

GUIDED_THROUGH = np.radians([[40, 20, -30, 25, 60], [-40, -20, 20, -15, -60], [0, 0, 0, 0, 0]])
ACCELERATION = to_rad(200.0)
PATIENCE = 20.0
TOGETHER_DEG = 0.2  # two ticks of an encoder; what is closer does not make the follower move


def in_simulation() -> None:
    """A program moves the leader; the follower does the same, a moment later."""
    with (
        so101.open_simulated(acceleration=ACCELERATION) as leader,
        so101.open_simulated(acceleration=ACCELERATION) as follower,
        Teleop(
            LocalLeader(LocalArm(station=leader, jaw=leader), lets_go=False),
            LocalFollower(LocalArm(station=follower, jaw=follower)),
            leader.clock,
        ) as teleop,
    ):
        teleop.start()
        for q in GUIDED_THROUGH:
            leader.arm.move(so101.JointGoal(q=q))
            leader.gripper.move(0.5 + 0.5 * np.sign(q[0]))
            off = come_together(teleop, leader, follower)
            print(f"leader at {np.round(to_deg(q)).astype(int)} deg, follower {off:.2f} deg off")


def come_together(teleop: Teleop, leader: so101.Rig, follower: so101.Rig) -> float:
    """Give the follower time; how far off it still is [deg]."""
    until = time.monotonic() + PATIENCE
    while (off := apart(leader, follower)) > TOGETHER_DEG and time.monotonic() < until:
        if teleop.status.phase is Phase.WAITING:
            # It lost the leader for a moment, on a very busy computer, and holds until the leader
            # is brought back to it. To begin again brings it, slowly, to the leader instead.
            teleop.stop()
            teleop.start()
        time.sleep(0.02)
    return off


def by_hand(leader_port: str, follower_port: str) -> None:
    """You lead; runs until Ctrl-C."""
    with (
        open_port(leader_port) as leader,
        open_port(follower_port) as follower,
        Teleop(
            LocalLeader(LocalArm(station=leader, jaw=leader)),
            LocalFollower(LocalArm(station=follower, jaw=follower), guarded=True),
            leader.clock,
        ) as teleop,
        contextlib.suppress(KeyboardInterrupt),
    ):
        teleop.start()
        while teleop.status.is_running:
            status = teleop.status
            joint, gap = status.gap
            why = status.reason or f"{joint} is {to_deg(gap):.1f} deg off"
            print(f"{status.phase.value}: {why}")
            time.sleep(0.5)


def open_port(port: str) -> so101.Rig:
    """The arm and gripper on a port, calibrated as the servos say."""
    asked = so101.ServoSettings(port=port).with_arm(SERVO_IDS).with_gripper(GRIPPER_ID)
    return so101.open_hardware(asked)


def apart(leader: so101.Rig, follower: so101.Rig) -> float:
    """The largest difference between the arms' joints [deg]."""
    return float(to_deg(np.max(np.abs(leader.arm.state.q - follower.arm.state.q))))


def main() -> None:
    """Lead and follow."""
    parser = argparse.ArgumentParser(description="One arm follows another.")
    parser.add_argument("--leader", metavar="PORT", help="an arm that is guided by hand")
    parser.add_argument("--follower", metavar="PORT", help="an arm that WILL move")
    asked = parser.parse_args()
    if bool(asked.leader) != bool(asked.follower):
        parser.error("give both ports, or none for two simulated arms")
    if asked.leader:
        by_hand(asked.leader, asked.follower)
    else:
        in_simulation()


if __name__ == "__main__":
    main()
