"""Manual mode on a real executor and the emulated servos."""

from concurrent.futures import wait

import numpy as np
import pytest
from harness.emulated_rig import arm_client

from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import MotionError
from so101_motion.common.modes import Mode
from so101_motion.drivers.emulator import registers as emu
from so101_motion.drivers.emulator.hand import Hand, parse_script
from so101_motion.tasks.guided import PathRecorder, plan_replay, start_replay

LEAD = "0.1 shoulder_pan start\n2.1 shoulder_pan 30\n2.6 shoulder_pan release\n"


def lead(bench, script=LEAD):
    bench.emulator.advance()
    bench.world.hand = Hand(parse_script(script), bench.clock.now())


def limits(bench):
    servos = [bench.world.servo(place) for place in range(1, 7)]
    return [servo.memory.raw(emu.TORQUE_LIMIT) for servo in servos]


@pytest.fixture
def rig(bench):
    rig = bench.open()
    bench.advance(1.0)
    rig.arm.set_manual(True)
    return rig


def test_setting_the_servos_up_anew_ends_it_without_a_jump_and_it_can_begin_again(bench, rig):
    lead(bench)
    bench.advance(3.0)
    here = bench.q_deg
    rig.reload()
    assert rig.arm.state.mode is Mode.HOLDING
    bench.advance(1.0)

    assert limits(bench) == [1000] * 5 + [500]
    assert bench.q_deg == pytest.approx(here, abs=0.5)
    rig.arm.set_manual(True)
    bench.advance(0.5)
    assert rig.arm.state.mode is Mode.GUIDING
    assert bench.q_deg == pytest.approx(here, abs=0.5)


def test_the_jaw_opens_and_closes_while_the_arm_is_guided(bench, rig):
    bench.finish(rig.gripper.move(0.5, wait=False))
    assert rig.gripper.aperture == pytest.approx(0.5, abs=0.02)
    assert rig.arm.state.mode is Mode.GUIDING
    motion = rig.gripper.move(0.9, wait=False)
    bench.advance(0.2)
    with pytest.raises(MotionError, match="jaw is moving"):
        bench.finish(rig.executor.release())
    bench.finish(rig.executor.hold())
    assert rig.arm.state.mode is Mode.MOVING
    bench.finish(motion)
    assert rig.arm.state.mode is Mode.HOLDING


def test_a_dead_servo_is_a_fault_and_the_others_hold(bench, rig):
    bench.world.disconnect("wrist_roll")
    bench.advance(0.5)

    assert rig.arm.state.mode is Mode.FAULT
    assert "wrist_roll" in rig.arm.state.fault
    assert limits(bench)[:4] == [1000] * 4


# As a component


async def test_the_configuration_and_the_request_say_how_it_yields(models):
    arm = models.new_arm(manual_mode={"pos_deadband_deg": 1.0, "torque_limit": 80.0})
    assert arm.rig.arm.compliance == Compliance(dead_band=np.radians(1.0), resistance=0.08)
    await models.pass_time(1.0)
    async with arm_client(arm) as client:
        answer = await models.in_time(
            client.do_command({"command": "enter_manual_mode", "torque_limit": 120.0})
        )
        assert answer == {"mode": "manual", "servos": [1, 2, 3, 4, 5]}
        await models.pass_time(0.5)
        assert limits(models)[0] == pytest.approx(120, abs=25)
        status = await client.get_status()
        assert (status["mode"], status["state"]) == ("manual", "guiding")
        assert await models.in_time(client.do_command({"command": "exit_manual_mode"})) == {
            "mode": "auto"
        }
        await models.in_time(client.set_manual_mode(True))
        await models.pass_time(0.5)
        assert limits(models)[0] == pytest.approx(80, abs=25)
        await models.in_time(client.stop())
        assert not await client.get_manual_mode()


# A path is taught and replayed

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


def finish(bench, motion):
    """Let time pass until ``motion`` is over, and its own thread do what it does between legs."""
    for _ in range(2000):
        if wait([motion.future], timeout=max(0.002, bench.turn)).done:
            break
        bench.advance(0.02)
    motion.result(timeout=0.0)


@pytest.fixture
def taught(bench):
    rig = bench.open()
    rig.arm.set_speed(np.radians(60.0))
    bench.advance(1.0)
    rig.arm.set_manual(True)
    return rig


@pytest.mark.emulated(reply_timeout=2.0)
def test_the_arm_replays_a_taught_path_and_the_jaw_grips(bench, taught):
    bench.finish(taught.gripper.move(0.7, wait=False))
    recorder = PathRecorder(taught.executor, taught.gripper)
    lead(bench, GUIDED)
    bench.advance(3.4)
    lead(bench, NUDGE)  # as a person does who has only two hands
    bench.finish(taught.gripper.grab(wait=False))
    path = recorder.end()
    end = bench.arm_deg(taught)
    taught.arm.set_manual(False)
    assert np.ptp(np.degrees(path.q[:, 0])) == pytest.approx(30.0, abs=3.5), (
        "the hand is a spring, and friction up to 0.35 N m holds the joint back by 1 deg an end"
    )
    assert path.aperture[-1] < 0.1 < 0.6 < path.aperture[0]
    closing = np.degrees(path.q[path.aperture < 0.6])
    assert np.ptp(closing, axis=0).max() > 0.5, "and yet the jaw closes at its own speed"

    bench.finish(taught.gripper.move(0.7, wait=False))
    bench.world.put_object(0.03)
    replay = plan_replay(taught.arm, path, gripper=taught.gripper)
    assert replay.duration < path.duration + 4.0, (
        "a leg may take twice as long as the arm alone, for its jaw; which legs are depends on when"
        " the nudge came"
    )
    begin, tape = bench.clock.now(), []
    stop = taught.executor.listen(lambda state: tape.append((state.t, *state.q)))
    finish(bench, start_replay(taught.arm, taught.gripper, replay))
    stop()
    table = np.degrees(np.array([row for row in tape if row[0] > begin])[:, 1:])
    for q in np.degrees(path.q)[::10]:
        assert np.abs(table - q).max(axis=1).min() < 3.5, "2 deg and what the servos are behind"
    assert bench.arm_deg(taught) == pytest.approx(end, abs=1.5)
    assert taught.gripper.is_holding
    assert taught.arm.state.mode is Mode.HOLDING
