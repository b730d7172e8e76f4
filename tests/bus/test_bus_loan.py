from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from harness.emulated_rig import hardware_bench
from harness.held_calibration import filed

from so101_motion.calib.procedure.eeprom import write_calibration
from so101_motion.calib.record import store
from so101_motion.common.errors import MotionError, NoReply
from so101_motion.common.modes import Mode
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.emulator import registers as emu
from so101_motion.drivers.emulator.faults import FaultEvent
from so101_motion.planning.goals import JointGoal

NOBODY = {"servo_ids": None, "gripper_id": None}


def memory(bench, joint):
    return bench.world.servo(joint).memory


def let_go(bus):
    for servo_id in range(1, 7):
        bus.write(servo_id, reg.TORQUE_ENABLE, 0)


# Having the bus


def test_lending_moves_nothing_and_other_requests_are_refused_with_the_reason(bench):
    rig = bench.open()
    bench.advance(1.0)
    before = bench.q_deg
    rig.lend_bus("calibration")
    for ask in (
        lambda: bench.finish(rig.arm.move(goal_of(20), wait=False)),
        lambda: bench.finish(rig.arm.retarget(np.zeros(5))),
        rig.arm.stream,
        lambda: bench.finish(rig.gripper.move(0.5, wait=False)),
        lambda: bench.finish(rig.gripper.grab(wait=False)),
        lambda: rig.arm.set_manual(True),
        lambda: rig.arm.set_manual(False),
        lambda: rig.executor.release().result(),
        lambda: rig.executor.call(lambda driver: driver.read()).result(),
        rig.reload,
    ):
        with pytest.raises(MotionError, match="in use for calibration; finish or abort that"):
            ask()
    rig.arm.stop()
    rig.gripper.stop()
    bench.advance(1.0)

    assert rig.arm.state.mode is Mode.CALIBRATING
    assert rig.arm.state.lent_to == "calibration"
    assert bench.q_deg == pytest.approx(before, abs=0.5)
    assert bench.driven == [True] * 6


def goal_of(pan_deg):
    return JointGoal(q=np.radians([float(pan_deg), 0, 0, 0, 0]))


def test_it_is_lent_to_one_at_a_time_and_not_while_something_moves(bench):
    rig, other = bench.open(), bench.open()
    motion = bench.go(rig, 40, 0, 0, 0, 0)
    bench.under_way(motion, rig)
    with ThreadPoolExecutor(1) as pool, pytest.raises(MotionError, match="moving"):
        bench.finish(pool.submit(rig.lend_bus, "calibration"))
    bench.finish(motion)
    loan = rig.lend_bus("calibration")
    with pytest.raises(MotionError, match="in use for calibration"):
        other.lend_bus("motor setup")
    loan.give_back()
    loan.give_back()
    other.lend_bus("motor setup").give_back(hold=True)

    assert rig.arm.state.mode is Mode.HOLDING


def test_a_watching_job_is_called_at_every_tick_until_it_is_ended(bench):
    loan = bench.open().lend_bus("calibration")
    seen = []
    loan.watch(lambda bus: seen.append(bus.read(1, reg.PRESENT_POSITION)))
    bench.advance(1.0)
    assert 98 <= len(seen) <= 102
    loan.watch(None)
    count = len(seen)
    bench.advance(0.5)

    assert len(seen) == count


def test_a_watching_job_that_fails_ends_and_the_next_call_tells(bench):
    rig = bench.open()
    loan = rig.lend_bus("calibration")
    calls = []

    def fails(bus):
        calls.append(bus)
        raise LookupError("the joint went missing")

    loan.watch(fails)
    bench.advance(0.5)
    assert len(calls) == 1
    assert rig.arm.state.mode is Mode.CALIBRATING
    with pytest.raises(LookupError, match="went missing"):
        loan.call(lambda bus: None)
    loan.call(lambda bus: None)


def test_where_the_joints_are_is_reported_while_a_hand_moves_them(bench):
    rig = bench.open()
    loan = rig.lend_bus("calibration")
    loan.call(let_go)
    bench.world.servo("shoulder_pan").drive.shaft.put(2048.0 + 512.0)
    bench.advance(0.2)

    assert np.degrees(rig.arm.state.q[0]) == pytest.approx(45.0 - 4.1, abs=0.7)
    assert rig.servos.positions["shoulder_pan"] == pytest.approx(2560, abs=8)
    bench.world.disconnect("wrist_roll")
    bench.advance(0.2)
    assert "wrist_roll" not in rig.servos.positions
    assert rig.arm.state.mode is Mode.CALIBRATING


def test_a_servo_that_is_hot_is_told_while_its_arm_is_limp(bench):
    rig = bench.open()
    lease = rig.lend_bus("calibration")
    bench.emulator.begin(FaultEvent(kind="hot", servo="gripper", value=72.0))
    bench.advance(0.5)
    assert [each.temperature_c >= 70 for each in rig.servos.health] == [False] * 5 + [True]
    assert list(rig.arm.state.reading.alarms) == ["gripper"]
    bench.emulator.begin(FaultEvent(kind="dead", servo="elbow_flex"))
    bench.advance(1.0)
    assert [each.joint for each in rig.servos.health if each.is_silent] == ["elbow_flex"]
    bench.emulator.end(FaultEvent(kind="dead", servo="elbow_flex"))
    bench.advance(1.0)
    lease.give_back()


def test_the_driver_leaves_a_servo_alone_that_comes_up_meanwhile(bench):
    rig = bench.open()
    loan = rig.lend_bus("motor setup")
    bench.world.reboot("elbow_flex")
    bench.advance(2.0)

    assert loan.call(lambda bus: bus.read(3, reg.TORQUE_ENABLE)) == 0
    assert loan.call(lambda bus: bus.read(3, reg.PRESENT_POSITION)) > 0


def test_the_port_talks_at_another_rate_when_asked(bench):
    memory(bench, "elbow_flex").keep(emu.BAUD, 1)
    rig = bench.open(**NOBODY)
    loan = rig.lend_bus("motor setup")
    with pytest.raises(NoReply):
        loan.call(lambda bus: bus.ping(3))
    loan.at_baud(500_000)
    bench.advance(0.5)

    assert loan.call(lambda bus: bus.read(3, reg.ID)) == 3
    loan.at_baud(1_000_000)
    assert loan.call(lambda bus: bus.answering(range(1, 7))) == [1, 2, 4, 5, 6]


# Giving it back


def test_given_back_without_more_ado_the_arm_is_limp_and_can_be_held(bench):
    rig = bench.open()
    with rig.lend_bus("calibration") as loan:
        loan.call(let_go)
        bench.advance(0.1)
    assert rig.arm.state.mode is Mode.LIMP
    assert bench.driven == [False] * 6
    assert rig.arm.state.lent_to is None
    with pytest.raises(MotionError, match="no longer in use for calibration"):
        loan.call(lambda bus: None)
    bench.finish(rig.executor.hold())
    bench.advance(1.0)

    assert bench.driven == [True] * 6


@pytest.mark.parametrize(("limp", "mode"), [((1, 2), Mode.HOLDING), (range(1, 7), Mode.LIMP)])
def test_a_borrower_that_fails_leaves_an_arm_that_does_not_fall(bench, limp, mode):
    rig = bench.open()

    def borrow():
        with rig.lend_bus("calibration") as loan:
            for servo_id in limp:
                loan.call(lambda bus, i=servo_id: bus.write(i, reg.TORQUE_ENABLE, 0))
            raise LookupError

    with pytest.raises(LookupError):
        borrow()

    assert rig.arm.state.mode is mode
    assert bench.driven == [mode is Mode.HOLDING] * 6


def test_the_bus_goes_back_with_the_component_that_had_lent_it(bench):
    arm, sensor = bench.open(), bench.open(**NOBODY)
    loan = sensor.lend_bus("calibration")
    sensor.close()

    assert arm.arm.state.mode is Mode.HOLDING
    with pytest.raises(MotionError, match="no longer"):
        loan.call(lambda bus: None)


def test_a_port_that_is_closed_meanwhile_leaves_the_servos_as_they_are(bench):
    rig = bench.open()
    loan = rig.lend_bus("calibration")
    loan.call(lambda bus: bus.write(1, reg.TORQUE_ENABLE, 0))
    rig.close()

    assert bench.driven == [False, *[True] * 5]
    with pytest.raises(MotionError, match="was closed while it was in use for calibration"):
        loan.call(lambda bus: None)
    loan.give_back()


def test_servos_that_are_gone_when_the_bus_comes_back_are_a_fault_until_they_return(bench):
    rig = bench.open()
    loan = rig.lend_bus("motor setup")
    bench.world.disconnect("elbow_flex")
    with pytest.raises(NoReply, match="elbow_flex"):
        loan.give_back(hold=True)
    assert rig.arm.state.mode is Mode.FAULT
    assert "elbow_flex" in rig.arm.state.fault
    bench.world.connect("elbow_flex")
    bench.advance(3.0)
    bench.finish(rig.executor.hold())

    assert rig.arm.state.mode is Mode.HOLDING


def test_a_component_added_meanwhile_waits_for_the_servos_but_not_for_the_rig(bench):
    sensor = bench.open(**NOBODY)
    loan = sensor.lend_bus("calibration")
    file = filed(bench, is_new=False, shoulder_pan=(1100, 3100))
    arm = bench.open(calibration_file=file)
    assert arm.arm.state.mode is Mode.CALIBRATING
    loan.call(lambda bus: write_calibration(bus, store.load(file)))
    loan.give_back(hold=True)

    assert arm.servos.calibration["shoulder_pan"].range_min == 1100
    assert arm.arm.state.mode is Mode.HOLDING


# Where there is no arm yet


@pytest.mark.parametrize("ids", [{}, {6: 1}])
def test_a_fresh_kit_can_be_opened_and_its_bus_lent(tmp_path, ids):
    with hardware_bench(tmp_path, ids=ids, calibrated=False) as bench:
        rig = bench.open(**NOBODY)
        loan = rig.lend_bus("motor setup")
        assert loan.call(lambda bus: bus.ping_all()).ids == tuple(sorted(ids.values()))
        loan.give_back()
        bench.advance(0.5)
        with pytest.raises(MotionError, match="configure an arm or a gripper"):
            bench.finish(rig.arm.move(goal_of(20), wait=False))


@pytest.mark.emulated(ids={})
def test_an_arm_that_is_switched_on_later_is_seen_and_a_component_can_use_it(bench):
    sensor = bench.open(**NOBODY)
    for place in range(1, 7):
        bench.world.connect(place)
    bench.advance(2.0)
    assert len(sensor.servos.setups) == 6
    assert bench.driven == [False] * 6
    arm = bench.open()
    assert arm.arm.state.mode is Mode.HOLDING
    assert bench.driven == [True] * 6
