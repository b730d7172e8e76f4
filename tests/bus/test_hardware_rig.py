import json
import time
from contextlib import closing

import numpy as np
import pytest
from harness.emulated_rig import rad
from harness.held_calibration import filed, hold_calibration

from so101_motion.calib.record import lerobot, record, store
from so101_motion.common.errors import ConfigError, NoReply, OtherCalibration
from so101_motion.common.modes import Mode
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.emulator import registers as emu
from so101_motion.drivers.port.serial_port import SerialPort
from so101_motion.rig.hardware_rig import open_so101
from so101_motion.tasks.teleop.sides import middles_of


def memory(bench, joint):
    return bench.world.servo(joint).memory


# Opening


def test_one_port_is_opened_once_however_it_is_spelled(bench):
    arm = bench.open(gripper_id=None)
    gripper = bench.open(port=bench.emulator.port, servo_ids=None)

    assert arm.executor is gripper.executor
    assert (arm.users, gripper.users) == (2, 2)
    arm.close()
    arm.close()
    assert gripper.users == 1
    assert gripper.arm.state.mode is Mode.HOLDING
    gripper.close()
    again = bench.open()
    assert again.users == 1
    assert again.executor is not gripper.executor


@pytest.mark.emulated(ids={1: 1, 2: 2, 3: 3, 6: 6})
def test_a_build_that_fails_releases_everything(bench):
    with pytest.raises(NoReply, match=r"wrist_flex.*wrist_roll"):
        bench.open()
    for place in (4, 5):
        bench.world.connect(place)
    bench.advance(2.0)
    assert bench.open().arm.state.mode is Mode.HOLDING


@pytest.mark.emulated(ids={i: i for i in range(1, 6)})
def test_an_arm_without_a_gripper_works(bench):
    rig = bench.open(gripper_id=None)
    bench.finish(bench.go(rig, 10, 0, 0, 0, 0))
    assert np.degrees(rig.arm.state.q[0]) == pytest.approx(10.0, abs=0.35)
    with pytest.raises(NoReply, match="gripper"):
        bench.open(servo_ids=None)
    assert rig.arm.state.mode is Mode.HOLDING


@pytest.mark.emulated(ids={6: 6})
def test_a_gripper_alone_can_be_joined_by_its_arm(bench):
    gripper = bench.open(servo_ids=None)
    assert set(gripper.servos.setups) == {"gripper"}
    for place in range(1, 6):
        bench.world.connect(place)
    bench.advance(2.0)
    arm = bench.open(gripper_id=None)
    assert len(arm.servos.setups) == 6
    assert arm.users == 2


# Calibration


def test_servos_without_a_calibration_have_the_files_until_their_power_goes(bench):
    path = filed(bench)
    before = bench.q_deg
    flash = [servo.memory.flash for servo in bench.world.servos]
    rig = bench.open(calibration_file=path)
    bench.advance(1.0)

    assert {setup.source for setup in rig.servos.setups.values()} == {"file"}
    assert memory(bench, "shoulder_pan").raw(emu.MIN_POSITION) == 900
    assert [servo.memory.flash for servo in bench.world.servos] == flash
    assert "gripper: the servo holds no calibration" in " ".join(rig.servos.notes)
    assert rig.arm.state.q[0] == pytest.approx(rad(360.0 * 48 / 4096), abs=rad(0.5))
    assert bench.q_deg == pytest.approx(before, abs=0.5)


def test_another_calibration_is_refused_and_when_it_is_accepted_no_joint_moves(bench):
    bench.open().close()
    bench.advance(0.5)
    before, file = bench.q_deg, filed(bench, is_new=False, offsets={"shoulder_pan": 200})
    flash = [servo.memory.flash for servo in bench.world.servos]
    with pytest.raises(OtherCalibration, match=r"homing_offset is 200.*so101 calibration write"):
        bench.open(calibration_file=file)
    looks = bench.open(servo_ids=None, gripper_id=None, timeout=None, calibration_file=file)
    assert [servo.memory.flash for servo in bench.world.servos] == flash
    kept = looks.write_calibration()
    rig = bench.open(calibration_file=file)
    bench.advance(1.0)

    assert store.read(kept).calibration["shoulder_pan"].homing_offset == 0
    assert memory(bench, "shoulder_pan").raw(emu.OFFSET) == 200
    assert bench.q_deg == pytest.approx(before, abs=0.6), "it went on holding"
    assert rig.arm.state.q[0] == pytest.approx(rad(360.0 * (48 - 200) / 4096), abs=rad(0.6))


@pytest.mark.parametrize(
    ("change", "from_servos"),
    [
        ({"range_max": 910}, {"elbow_flex"}),
        ({"id": 4}, set(record.JOINTS)),  # it is not this arm's
    ],
)
def test_a_bad_joint_of_a_file_gives_way_to_its_servo_and_a_bad_file_to_all(
    bench, caplog, change, from_servos
):
    path = filed(bench)
    content = json.loads(path.read_text())
    content["elbow_flex"] |= change
    path.write_text(json.dumps(content))
    rig = bench.open(calibration_file=path)

    found = {joint for joint, setup in rig.servos.setups.items() if setup.source != "file"}
    assert found == from_servos
    assert "elbow_flex" in caplog.text
    is_unused = "calibration file is not used" in " ".join(rig.servos.notes)
    assert is_unused == (from_servos == set(record.JOINTS))


def test_a_servo_whose_limits_make_no_sense_has_the_defaults(bench):
    for joint, limits in (("elbow_flex", (3000, 1000)), ("gripper", (0, 4095))):
        for row, limit in zip((emu.MIN_POSITION, emu.MAX_POSITION), limits, strict=True):
            memory(bench, joint).keep(row, limit)
    servos = bench.open().servos
    used = {
        joint: (setup.calibration.range_min, setup.calibration.range_max)
        for joint, setup in servos.setups.items()
        if setup.source == "defaults"
    }
    assert used == {"elbow_flex": (500, 3500), "gripper": (2048, 3248)}
    notes = " ".join(servos.notes)
    assert "elbow_flex: the limits in the servo (3000 to 1000) make no sense" in notes
    assert "gripper: the limits in the servo (0 to 4095) are wider than the jaw" in notes


def test_what_a_file_says_now_is_taken_up_when_its_user_accepts_it(bench):
    path = filed(bench)
    rig = bench.open(calibration_file=path)
    bench.advance(0.5)
    before, was = bench.q_deg, rig.arm.state.q[0]
    store.save(path, {"shoulder_pan": record.JointCalibration(id=1, range_min=800)})
    with pytest.raises(OtherCalibration, match="range_min is 800 in the calibration"):
        rig.reload()
    assert rig.arm.state.q[0] == pytest.approx(was, abs=rad(0.5)), "it goes on as before"
    rig.write_calibration()
    bench.advance(1.0)

    assert rig.servos.calibration["shoulder_pan"].range_min == 800
    assert abs(rig.arm.state.q[0] - was) > rad(10.0), "the middle of the travel is elsewhere"
    assert bench.q_deg == pytest.approx(before, abs=0.5)
    bench.finish(bench.go(rig, *np.degrees(rig.arm.state.q)))


# The gripper


@pytest.mark.emulated(reply_timeout=2.0)
def test_a_stop_brakes_each_joint_no_harder_than_its_servo_does(bench):
    rig = bench.open()
    bench.advance(1.0)
    rig.arm.set_speed(rad(90.0))
    rig.arm.set_acceleration(rad(300.0))
    motion = bench.go(rig, 0, -55, 0, 0, 0)
    bench.under_way(motion, rig, 0.5)
    assert np.degrees(rig.arm.state.qd_ref[1]) < -80.0
    stopped, lowest = rig.arm.start_stop(), np.inf
    for _ in range(60):
        bench.advance(0.01)
        lowest = min(lowest, bench.arm_deg(rig)[1])
    bench.finish(stopped)
    assert np.degrees(rig.arm.state.q_ref[1]) - lowest < 4.2, "else it swings past by 4.8"


def test_what_is_held_is_still_held_after_the_cable_was_out(bench):
    rig = bench.open()
    bench.finish(rig.gripper.move(0.6, wait=False))
    bench.world.put_object(0.02)
    bench.finish(rig.gripper.grab(wait=False))
    bench.emulator.unplug()
    bench.advance(1.0)
    bench.emulator.plug()
    bench.advance(3.0)
    assert not rig.gripper.is_holding, "nobody can tell yet"
    bench.finish(rig.executor.hold())
    rig.gripper.regrip()
    bench.advance(1.0)

    assert rig.gripper.is_holding
    assert abs(rig.servos.health[5].load) > 0.1
    rig.reload()
    bench.advance(1.0)
    assert rig.gripper.is_holding


def test_setpoints_can_come_twice_as_often(bench):
    rig = bench.open(rate=200.0)
    motion = bench.go(rig, 10, -20, 20, 30, 0)
    bench.finish(motion)

    assert motion.plan.trajectory.dt == 0.005
    assert np.degrees(rig.arm.state.q) == pytest.approx([10, -20, 20, 30, 0], abs=0.35)


def test_another_rate_than_the_port_has_is_refused(bench):
    bench.open(gripper_id=None)
    with pytest.raises(ConfigError, match=r"control_rate_hz.*already runs at 100 Hz"):
        bench.open(servo_ids=None, rate=200.0)


def test_an_arm_is_opened_by_the_name_that_lerobot_gave_it(bench, tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    with pytest.raises(ConfigError, match="mine"):
        open_so101(str(bench.port), "mine", clock=bench.clock)
    open_so101(str(bench.port), clock=bench.clock).close()
    assert "no calibration file of this arm was found, so zero is" in caplog.text
    caplog.clear()
    calibration = store.load(filed(bench, shoulder_pan=(1100, 3000))).calibration
    lerobot.export(calibration, lerobot.path_for("mine"))
    hold_calibration(bench.world, calibration)
    with open_so101(str(bench.port), "mine", clock=bench.clock) as rig:
        assert rig.servos.calibration["shoulder_pan"].range_min == 1100
        assert middles_of(rig).shape == (5,)
    assert "no calibration file" not in caplog.text


def test_an_arm_is_held_although_the_machine_stands_still_after_a_look_at_it(bench, monkeypatch):
    rig = bench.open()
    bench.finish(rig.executor.release())
    write, stalls = rig.servos.write, iter((0.2,))

    def stand_still_and_write(*given):
        bench.clock._now += next(stalls, 0.0)
        return write(*given)

    monkeypatch.setattr(rig.servos, "write", stand_still_and_write)
    bench.finish(rig.executor.hold())
    assert bench.driven == [True] * 6


@pytest.mark.parametrize(
    ("on", "does", "holds"),
    [
        ((), "", False),
        (range(1, 7), "holds, as it was found", False),
        (range(1, 7), "holds, as it was found", True),
        ((2,), "is limp, but shoulder_lift holds", False),
        (range(1, 6), "holds, but gripper is limp", True),
    ],
)
def test_who_only_looks_at_an_arm_sees_which_joints_hold_and_can_let_go_of_or_hold_them(
    bench, on, does, holds
):
    bench.open().close()
    bench.advance(0.5)
    off = dict.fromkeys({1, 2, 3, 4, 5, 6}.difference(on), 0)
    with closing(Bus(SerialPort(str(bench.port)))) as bus:
        bus.write_each(reg.TORQUE_ENABLE, off)
        while bench.driven != [number in on for number in range(1, 7)]:
            time.sleep(0.001)  # what was not heard yet would be lost when the port is closed
    rig = bench.open(servo_ids=None, gripper_id=None, timeout=None)
    bench.advance(0.2)
    state, before = rig.arm.state, bench.q_deg
    assert (state.torque, state.is_limp, rig.arm.is_movable_by_hand) == (does, not on, not on)
    bench.emulator.unplug()
    bench.advance(0.1)
    assert rig.arm.state.torque == ""
    bench.emulator.plug()
    bench.advance(2.0)
    assert rig.arm.state.torque == does
    assert rig.servos.port_losses == 1

    if holds:
        rig.drive()
    else:
        bench.finish(rig.executor.release())
    bench.advance(0.2)
    state = rig.arm.state
    assert (state.mode is Mode.HOLDING, state.torque) == (holds, "")
    assert bench.driven == [holds] * 6
    assert not holds or bench.q_deg == pytest.approx(before, abs=0.5)
