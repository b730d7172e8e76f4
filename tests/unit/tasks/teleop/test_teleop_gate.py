import numpy as np
import pytest

from so101_motion.tasks.teleop.pilot import GATE, Gate, Phase

NEAR = np.array([0.0, 0.9 * GATE, 0.0, 0.0, 0.0])
FAR = np.array([0.0, 0.0, -3.0 * GATE, 0.0, 0.0])


def gate_in(phase):
    gate = Gate()
    if phase is not Phase.STOPPED:
        gate.begin()
    if phase is Phase.MIRRORING:
        gate.lets_go(NEAR)
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
        goes = gate.lets_go(off)
        assert gate.phase is after
        assert goes == (after not in (Phase.STOPPED, Phase.WAITING))


@pytest.mark.parametrize("phase", Phase)
def test_trouble_makes_whatever_runs_wait_and_a_stop_ends_it(phase):
    gate = gate_in(phase)
    gate.trouble("no answer")
    waits = (Phase.WAITING, "no answer")
    assert (gate.phase, gate.reason) == ((phase, "") if phase is Phase.STOPPED else waits)
    for ended in (gate, gate_in(phase)):
        ended.stop()
        assert ended.phase is Phase.STOPPED
        assert not ended.lets_go(NEAR)


@pytest.mark.parametrize("phase", [Phase.APPROACHING, Phase.MIRRORING])
def test_after_a_pause_the_follower_goes_on_as_before(phase):
    gate = gate_in(phase)
    gate.pause("no answer")
    assert gate.phase is Phase.WAITING
    assert gate.pauses_mirroring is (phase is Phase.MIRRORING)
    assert gate.lets_go(FAR)
    assert (gate.phase, gate.reason) == (phase, "")
    assert not gate.is_paused
    assert not gate.pauses_mirroring


def test_what_comes_on_top_of_a_pause_is_trouble():
    gate = gate_in(Phase.MIRRORING)
    gate.pause("no answer")
    gate.trouble("it was suddenly elsewhere")
    gate.pause("no answer")
    assert not gate.lets_go(FAR)
    assert not gate.pauses_mirroring
    assert (gate.phase, gate.reason) == (Phase.WAITING, "it was suddenly elsewhere")


@pytest.mark.parametrize(("off", "goes_on"), [(FAR, False), (NEAR, True)])
def test_a_follower_held_back_far_from_the_leader_comes_slowly(off, goes_on):
    gate = gate_in(Phase.MIRRORING)
    gate.lets_go(off)
    gate.hold_back()
    assert gate.phase is (Phase.MIRRORING if goes_on else Phase.APPROACHING)
    assert gate.lets_go(FAR)
    assert gate.phase is (Phase.MIRRORING if goes_on else Phase.APPROACHING)
