"""A path is taught to an arm by hand and replayed, on emulated servos with weight."""

from concurrent.futures import wait

import numpy as np
import pytest
from harness.emulated_rig import hardware_bench

from so101_motion.common.modes import Mode
from so101_motion.drivers.emulator.hand import Hand, parse_script
from so101_motion.tasks.guided import PathRecorder, plan_replay, start_replay

GUIDED = """
0.1 shoulder_pan start
0.1 shoulder_lift start
1.6 shoulder_pan 30
1.6 shoulder_lift -20
3.1 shoulder_pan 0
3.1 shoulder_lift -40
3.3 shoulder_pan release
3.3 shoulder_lift release
"""

NUDGE = """
0 shoulder_pan start
0.9 shoulder_pan 8.0
1.0 shoulder_pan release
"""


def lead(bench, script=GUIDED):
    bench.emulator.advance()
    bench.world.hand = Hand(parse_script(script), bench.clock.now())


def finish(bench, motion):
    """Let time pass until ``motion`` is over, and its own thread do what it does between legs."""
    for _ in range(2000):
        if wait([motion.future], timeout=max(0.002, bench.turn)).done:
            break
        bench.advance(0.02)
    motion.result(timeout=0.0)


@pytest.fixture
def bench(tmp_path, planning_process):
    with hardware_bench(tmp_path, is_heard=False, reply_timeout=2.0) as bench:
        yield bench


@pytest.fixture
def rig(bench):
    rig = bench.open()
    rig.arm.set_speed(np.radians(60.0))
    bench.advance(1.0)
    rig.arm.set_manual(True)
    return rig


def test_the_arm_replays_a_taught_path_and_the_jaw_grips(bench, rig):
    bench.finish(rig.gripper.move(0.7, wait=False))
    recorder = PathRecorder(rig.executor, rig.gripper)
    lead(bench)
    bench.advance(3.4)
    lead(bench, NUDGE)  # as a person does who has only two hands
    bench.finish(rig.gripper.grab(wait=False))
    path = recorder.end()
    end = bench.arm_deg(rig)
    rig.arm.set_manual(False)
    assert np.ptp(np.degrees(path.q[:, 0])) == pytest.approx(30.0, abs=3.5), (
        "the hand is a spring, and friction up to 0.35 N m holds the joint back by 1 deg an end"
    )
    assert path.aperture[-1] < 0.1 < 0.6 < path.aperture[0]
    closing = np.degrees(path.q[path.aperture < 0.6])
    assert np.ptp(closing, axis=0).max() > 0.5, "and yet the jaw closes at its own speed"

    bench.finish(rig.gripper.move(0.7, wait=False))
    bench.world.put_object(0.03)
    replay = plan_replay(rig.arm, path, gripper=rig.gripper)
    assert replay.duration < path.duration + 4.0, (
        "a leg may take twice as long as the arm alone, for its jaw; which legs are depends on when"
        " the nudge came"
    )
    begin, tape = bench.clock.now(), []
    stop = rig.executor.listen(lambda state: tape.append((state.t, *state.q)))
    finish(bench, start_replay(rig.arm, rig.gripper, replay))
    stop()
    table = np.degrees(np.array([row for row in tape if row[0] > begin])[:, 1:])
    for q in np.degrees(path.q)[::10]:
        assert np.abs(table - q).max(axis=1).min() < 3.5, "2 deg and what the servos are behind"
    assert bench.arm_deg(rig) == pytest.approx(end, abs=1.5)
    assert rig.gripper.is_holding
    assert rig.arm.state.mode is Mode.HOLDING


def test_a_cable_that_comes_out_loses_nothing_of_the_path(bench, rig):
    recorder = PathRecorder(rig.executor, rig.gripper)
    lead(bench)
    bench.advance(1.7)
    bench.emulator.unplug()
    bench.advance(0.3)
    assert recorder.ended_by == "the arm could not be reached any more"
    assert np.degrees(recorder.end().q[-1, 0]) > 20.0
    bench.emulator.plug()
    bench.advance(1.0)
