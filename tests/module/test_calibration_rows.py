"""Where a real arm's calibration comes from, through a real module process.

The file first, named relative to the module's data directory; without one what the servos have
stored, read anew at each start and kept nowhere; and defaults where that makes no sense. The servos
are those of ``so101 emulate`` and stay powered from test to test.
"""

import json

import numpy as np
import pytest
import pytest_asyncio
from harness.emulated_port import emulated_port
from harness.fake_parent import ARM, GRIPPER, HARDWARE_ARM, HARDWARE_GRIPPER, running_module

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.port.serial_port import SerialPort

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.emulator_only]

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
PATIENCE = 1.0  # [s], for a busy machine
STORED = (reg.HOMING_OFFSET, reg.MIN_POSITION, reg.MAX_POSITION)


class Session:
    """A module, and the port and the data directory that its arms use."""

    def __init__(self, module, port, data):
        self.module, self.port, self.data = module, port, data

    async def arm(self, **attributes):
        return await self.module.add(ARM, HARDWARE_ARM, {"port": self.port, **attributes}, "arm")

    async def without_arm(self):
        await self.module.remove(ARM, "arm")

    def stored(self):
        """What the six servos have in their EEPROM; while no component uses them."""
        bus = Bus(SerialPort(self.port), reply_timeout=PATIENCE)
        try:
            return [tuple(bus.read(i, row) for row in STORED) for i in range(1, 7)]
        finally:
            bus.close()

    def store(self, servo_id, *values):
        bus = Bus(SerialPort(self.port), reply_timeout=PATIENCE)
        try:
            bus.store(servo_id, dict(zip(STORED, values, strict=True)))
        finally:
            bus.close()

    def write(self, name, ranges):
        """A calibration file in the data directory, without norm_mode, as LeRobot writes them."""
        content = {
            joint: {
                "id": i, "drive_mode": 0, "homing_offset": offset,
                "range_min": lower, "range_max": upper,
            }
            for i, (joint, (offset, lower, upper)) in enumerate(
                zip(JOINTS, ranges, strict=True), start=1
            )
        }  # fmt: skip
        (self.data / name).write_text(json.dumps(content))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def session(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrations")
    data = folder / "data"
    data.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VIAM_MODULE_DATA", str(data))
        async with emulated_port(folder) as emulated, running_module() as (module, _, _):
            yield Session(module, emulated.port, data)


async def calibration(arm):
    return await arm.do_command({"command": "get_calibration"})


async def joints(arm):
    return np.array((await arm.get_joint_positions()).values)


def ranges(answer):
    found = answer["calibration"]
    names = ("homing_offset", "range_min", "range_max")
    return [tuple(found[joint][name] for name in names) for joint in JOINTS]


async def test_without_a_file_the_servos_are_asked_at_each_start_and_nothing_is_kept(session):
    held = session.stored()
    answer = await calibration(await session.arm())
    assert set(answer["source"].values()) == {"registers"}
    assert ranges(answer) == held
    assert answer["calibration_file"] == ""
    await session.without_arm()

    changed = (0, held[0][1] + 40, held[0][2] - 40)
    session.store(1, *changed)
    answer = await calibration(await session.arm())
    assert ranges(answer) == [changed, *held[1:]]
    await session.without_arm()
    assert session.stored() == [changed, *held[1:]]
    assert list(session.data.iterdir()) == []
    session.store(1, *held[0])


async def test_a_file_in_the_data_directory_comes_first_and_is_read_again_on_request(session):
    held = session.stored()
    filed = [(offset, lower + 30, upper - 10) for offset, lower, upper in held]
    session.write("mine.json", filed)
    arm = await session.arm(calibration_file="mine.json")
    answer = await calibration(arm)
    assert set(answer["source"].values()) == {"file"}
    assert answer["calibration_file"] == str(session.data / "mine.json")
    assert ranges(answer) == filed
    verified = await arm.do_command({"command": "verify_config"})
    assert verified == {"success": True, "error": ""}
    before = await joints(arm)

    again = [(offset, lower + 20, upper) for offset, lower, upper in filed]
    session.write("mine.json", again)
    answer = await arm.do_command({"command": "reload_calibration"})
    assert (answer["success"], answer["calibration_file"]) == (
        True,
        str(session.data / "mine.json"),
    )
    assert ranges(await calibration(arm)) == again
    moved = np.array([-10.0] * 5) * 360.0 / 4096.0  # zero is the middle of the travel
    assert await joints(arm) == pytest.approx(before + moved, abs=0.4), "the arm stayed"

    (session.data / "mine.json").write_text("{")
    answer = await arm.do_command({"command": "reload_calibration"})
    assert (answer["success"], "not JSON" in answer["error"]) == (False, True)
    assert ranges(await calibration(arm)) == again
    await session.without_arm()
    assert session.stored() == again, "the servos follow the file"
    for servo_id, values in enumerate(held, start=1):
        session.store(servo_id, *values)


async def test_a_file_that_is_no_good_gives_way_to_the_servos_and_that_is_said(session):
    held = session.stored()
    (session.data / "bad.json").write_text('{"shoulder_pan": 3}')
    arm = await session.arm(calibration_file="bad.json")
    assert set((await calibration(arm))["source"].values()) == {"registers"}
    notes = (await arm.get_status())["notes"]
    assert any("calibration file is not used" in note for note in notes)
    await session.without_arm()
    assert session.stored() == held


async def test_where_the_servos_make_no_sense_either_defaults_are_used_and_that_is_said(session):
    held = session.stored()
    session.store(3, 0, 3000, 1000)
    session.store(6, 0, 0, 4095)
    arm = await session.arm()
    gripper = await session.module.add(GRIPPER, HARDWARE_GRIPPER, {"port": session.port}, "gripper")
    answer = await calibration(arm)
    found, sources = ranges(answer), answer["source"]
    assert (found[2], sources["elbow_flex"]) == ((0, 500, 3500), "defaults")
    assert (found[5], sources["gripper"]) == ((0, 2048, 3248), "defaults")
    assert sources["shoulder_pan"] == "registers"
    notes = " ".join((await arm.get_status())["notes"])
    assert "elbow_flex: the limits in the servo (3000 to 1000) make no sense" in notes
    assert "gripper: the limits in the servo (0 to 4095) are wider than the jaw" in notes
    await gripper.open()
    place = await gripper.do_command({"command": "get_position"})
    assert place["servo_position"] < 3248
    await session.module.remove(GRIPPER, "gripper")
    await session.without_arm()
    session.store(3, *held[2])
    session.store(6, *held[5])
