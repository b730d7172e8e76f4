import numpy as np
import pytest

from so101_motion.tasks.teleop.gate import EASE, GATE, Gate, Phase
from so101_motion.tasks.teleop.pilot import Pace

PACE = Pace()
NEAR = np.array([0.0, 0.9 * GATE, 0.0, 0.0, 0.0])
FAR = np.array([0.0, 0.0, -3.0 * GATE, 0.0, 0.0])


def gate_in(phase):
    gate = Gate(PACE.full, PACE.approach)
    if phase is not Phase.STOPPED:
        gate.begin()
    if phase is Phase.MIRRORING:
        gate.decide(0.0, NEAR)
    if phase is Phase.WAITING:
        gate.trouble("lost")
    assert gate.phase is phase
    return gate


@pytest.mark.parametrize(
    ("phase", "near", "far"),
    [
        (Phase.STOPPED, Phase.STOPPED, Phase.STOPPED),
        (Phase.APPROACHING, Phase.MIRRORING, Phase.APPROACHING),
        (Phase.MIRRORING, Phase.MIRRORING, Phase.MIRRORING),
        (Phase.WAITING, Phase.MIRRORING, Phase.WAITING),
    ],
)
def test_the_table(phase, near, far):
    for off, after in ((NEAR, near), (FAR, far)):
        gate = gate_in(phase)
        limits = gate.decide(10.0, off)
        assert gate.phase is after
        assert (limits is None) == (after in (Phase.STOPPED, Phase.WAITING))


@pytest.mark.parametrize("phase", Phase)
def test_trouble_makes_whatever_runs_wait(phase):
    gate = gate_in(phase)
    gate.trouble("no answer")
    if phase is Phase.STOPPED:
        assert gate.phase is Phase.STOPPED
    else:
        assert (gate.phase, gate.reason) == (Phase.WAITING, "no answer")


@pytest.mark.parametrize("phase", Phase)
def test_a_stop_ends_it_from_anywhere(phase):
    gate = gate_in(phase)
    gate.stop()
    assert gate.phase is Phase.STOPPED
    assert gate.decide(1.0, NEAR) is None


@pytest.mark.parametrize("phase", [Phase.APPROACHING, Phase.MIRRORING])
def test_after_a_pause_the_follower_comes_slowly(phase):
    gate = gate_in(phase)
    gate.pause("no answer")
    assert gate.phase is Phase.WAITING
    assert gate.decide(1.0, FAR) is None
    gate.resume()
    assert gate.decide(1.1, FAR) is PACE.approach
    assert gate.decide(1.2, NEAR).velocity == pytest.approx(PACE.approach.velocity)
    assert not gate.is_paused


def test_what_comes_on_top_of_a_pause_is_trouble():
    gate = gate_in(Phase.MIRRORING)
    gate.pause("no answer")
    gate.trouble("it was suddenly elsewhere")
    gate.pause("no answer")
    gate.resume()
    assert (gate.phase, gate.reason) == (Phase.WAITING, "it was suddenly elsewhere")


def test_the_gap_is_that_of_the_joint_furthest_off():
    gate = gate_in(Phase.APPROACHING)
    gate.decide(0.0, FAR)
    assert gate.gap == ("elbow_flex", pytest.approx(3.0 * GATE))


def test_the_pace_rises_from_that_of_the_approach():
    gate = gate_in(Phase.WAITING)
    speeds = [gate.decide(5.0 + t, NEAR).velocity[0] for t in np.linspace(0.0, EASE, 6)]
    assert speeds[0] == pytest.approx(PACE.approach.velocity[0])
    assert np.all(np.diff(speeds) > 0.0)
    assert gate.decide(5.0 + EASE, NEAR) is PACE.full
    assert gate.share(5.0 + EASE / 2) == pytest.approx(0.5)


def test_who_was_held_back_far_from_the_leader_comes_slowly():
    gate = gate_in(Phase.MIRRORING)
    gate.decide(1.0, FAR)
    gate.hold_back()
    assert gate.phase is Phase.APPROACHING
    assert gate.decide(2.0, FAR) is PACE.approach


def test_who_was_held_back_near_the_leader_goes_on():
    gate = gate_in(Phase.MIRRORING)
    gate.decide(1.0, NEAR)
    gate.hold_back()
    assert gate.phase is Phase.MIRRORING
