"""Discovery on real pseudo-terminals with emulated arms behind them."""

import json
import os
import threading
import time
from contextlib import ExitStack

import pytest
from harness.emulated_rig import hardware_bench

from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.emulator import registers as emulated
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.port.port_list import FoundPort
from so101_motion.drivers.port.serial_port import SerialPort
from so101_motion.drivers.servo_types import STS3215_7V4
from so101_motion.setup import discovery

APART = (0.1, -0.4, 0.5, -0.2, 0.7, 0.3)


class Table:
    """A computer with arms on its ports."""

    def __init__(self, folder, stack):
        self.data = folder / "data"
        self.home = folder / "home"
        self._stack = stack
        self.ports = []

    def arm(self, key="58CD", *, is_servo_adapter=True, **options):
        emulator = self._stack.enter_context(Emulator(EmulatorOptions(**options)))
        self.port(key, emulator.port, is_servo_adapter=is_servo_adapter)
        return emulator

    def port(self, key, name, *, is_servo_adapter=True):
        self.ports.append(
            FoundPort(name=name, device=name, key=key, is_servo_adapter=is_servo_adapter)
        )

    def look(self):
        return discovery.discover(find=lambda extra: tuple(self.ports))

    def only(self):
        (report,) = self.look().reports
        return report

    def calibrate(self, emulator, shift):
        """Store limits that no other arm has; the calibration."""
        made = {}
        for place, joint in enumerate(JOINTS, start=1):
            made[joint] = JointCalibration(
                id=place,
                homing_offset=10 * place + shift,
                range_min=1000 + shift,
                range_max=2200 + place + shift,
                norm_mode=1 if place == 6 else 3,
            )
            memory = emulator.world.servo(str(place)).memory
            memory.keep(emulated.OFFSET, 10 * place + shift)
            memory.keep(emulated.MIN_POSITION, 1000 + shift)
            memory.keep(emulated.MAX_POSITION, 2200 + place + shift)
        return made

    def write(self, path, calibration, *, lerobot=False):
        path.parent.mkdir(parents=True, exist_ok=True)
        content = {joint: entry.to_json() for joint, entry in calibration.items()}
        if lerobot:
            for entry in content.values():
                del entry["norm_mode"]
        path.write_text(json.dumps(content))
        return path


@pytest.fixture
def table(tmp_path, monkeypatch):
    with ExitStack() as stack:
        made = Table(tmp_path, stack)
        made.data.mkdir()
        made.home.mkdir()
        monkeypatch.setenv("VIAM_MODULE_DATA", str(made.data))
        monkeypatch.setenv("HOME", str(made.home))
        for name in ("VIAM_HOME", "HF_HOME", "HF_LEROBOT_HOME", "HF_LEROBOT_CALIBRATION"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.chdir(tmp_path)
        # A busy machine needs longer to look at several ports than a person would wait.
        monkeypatch.setattr(discovery.in_parallel, "__defaults__", (60.0,))
        yield made


def names(report):
    return [one.name for one in report.suggestions]


# What is there


def test_an_arm_is_found_with_all_that_can_be_configured(table):
    table.arm()
    report = table.only()
    assert names(report) == ["so101-arm-58CD", "so101-gripper-58CD", "so101-calibration-58CD"]
    assert report.sentence.startswith("a follower arm with 5 joints and a gripper, 12 V type; ")
    assert report.role == "follower"
    assert not report.in_use


def test_one_port_that_fails_hides_no_other(table):
    table.port("gone", "/dev/ttyACM9")
    table.port("nothing", os.devnull)
    table.arm("58CD")
    table.arm("59AB", kind=STS3215_7V4, volts=7.4)
    dark = table.arm("dark")
    dark.world.power(0.0)
    reports = {report.port.key: report for report in table.look().reports}
    assert [report.port.key for report in reports.values()] == [p.key for p in table.ports]
    assert "no such port" in reports["gone"].sentence
    assert reports["nothing"].suggestions == ()
    assert reports["58CD"].has_arm
    assert reports["59AB"].has_arm
    assert reports["59AB"].role == "unknown"
    assert "power supply" in reports["dark"].sentence
    assert reports["dark"].suggestions == ()


def test_a_kit_as_new_gets_the_sensor_that_sets_it_up(table):
    table.arm(calibrated=False, ids=dict.fromkeys(range(1, 7), 1), q_start=APART)
    report = table.only()
    assert names(report) == ["so101-calibration-58CD"]
    assert "several new motors answer, all with the id 1" in report.sentence
    assert "connect only one of them" in report.sentence


def at_rate(emulator, baud):
    for servo in emulator.world.servos:
        servo.memory.keep(emulated.BAUD, reg.BAUDS.index(baud))


def test_an_arm_at_another_rate_is_found_and_its_rate_configured(table):
    at_rate(table.arm(), 115_200)
    report = table.only()
    assert report.has_arm
    assert all(one.attributes["baudrate"] == 115_200 for one in report.suggestions)
    assert "at 115200 baud" in report.sentence


def test_a_port_that_is_hardly_a_servo_adapter_is_asked_at_one_rate_only(table):
    at_rate(table.arm(is_servo_adapter=False), 115_200)
    assert not table.only().has_arm


def test_no_port_at_all_is_explained(table):
    found = table.look()
    assert found.reports == ()
    assert "no USB serial adapter is plugged in" in found.notes[0]


def test_a_port_that_hangs_is_reported_and_holds_up_nobody():
    free = threading.Event()
    ports = [FoundPort(name=key, device=key, key=key) for key in ("slow", "quick")]

    def look(port):
        if port.key == "slow":
            free.wait(60.0)
        return discovery.PortReport(port=port, sentence="fine")

    try:
        slow, quick = discovery.in_parallel(ports, look, longest=1.5)
    finally:
        free.set()
    assert "takes longer than 1.5 s" in slow.sentence
    assert quick.sentence == "fine"


# Ports in use


def test_a_port_another_program_has_open_is_left_alone(table):
    emulator, heard = table.arm(), []
    emulator.bus.observers.append(lambda _t, data: heard.append(data))
    other = SerialPort(emulator.port)
    try:
        report = table.only()
        assert not heard
    finally:
        other.close()
    assert "in use by" in report.sentence
    assert report.suggestions == ()


def test_a_running_arm_is_not_disturbed_and_is_still_suggested(table, tmp_path):
    with hardware_bench(tmp_path, q_start=(0.3, 0.0, 0.0, 0.0, 0.0, 0.5)) as bench:
        rig = bench.open(gripper_id=None)
        bench.advance(1.0)
        table.port("58CD", str(bench.port))
        motion = bench.go(rig, 40, 0, 0, 0, 0)
        bench.under_way(motion, rig)
        bench.world.lock.acquire()  # nobody would be answered now
        try:
            begin = time.monotonic()
            (report,) = table.look().reports
            assert time.monotonic() - begin < 60.0, "nobody is waited for"
        finally:
            bench.world.lock.release()
        bench.finish(motion)
        assert bench.q_deg[0] == pytest.approx(40.0, abs=6.0)
    assert report.in_use
    assert names(report) == ["so101-gripper-58CD", "so101-calibration-58CD"]
    assert report.servo_ids == (1, 2, 3, 4, 5, 6)
    assert report.sentence == "used by a component of this machine, with 5 joints and a gripper"


def test_by_whatever_name_the_running_arm_was_opened(table, tmp_path):
    with hardware_bench(tmp_path) as bench:
        bench.open()
        table.port("58CD", bench.emulator.port)
        table.port("58CD", os.path.realpath(bench.port))
        assert all(report.in_use for report in table.look().reports)


def test_arms_are_not_said_to_stand_in_one_place(table):
    table.arm("A"), table.arm("B")
    found = table.look()
    frames = [[one.frame for one in report.suggestions] for report in found.reports]
    assert frames == [
        [{"parent": "world"}, {"parent": "so101-arm-A"}, None],
        [
            {"parent": "world", "translation": {"x": 0.0, "y": 500.0, "z": 0.0}},
            {"parent": "so101-arm-B"},
            None,
        ],
    ]
    assert any("set the frame of each arm to where it stands" in note for note in found.notes)


# Calibration files


def test_the_file_that_says_what_the_servos_hold_is_configured(table):
    first, second = table.arm("A"), table.arm("B")
    table.write(table.data / "one.json", table.calibrate(first, 0))
    store.save(table.data / "two.json", table.calibrate(second, 100))
    reports = table.look().reports
    assert [report.calibration for report in reports] == [
        table.data / "one.json", table.data / "two.json",
    ]  # fmt: skip
    for report, name in zip(reports, ("one.json", "two.json"), strict=True):
        assert all(s.attributes["calibration_file"] == name for s in report.suggestions)
        assert f"its servos agree with {table.data / name}" in report.sentence


@pytest.mark.parametrize(
    ("name", "is_taken", "says"),
    [
        ("so101_calibration.json", False, "calibrated, but no calibration file was found"),
        ("58CD_calibration.json", True, "though its servos hold something else"),
    ],
)
def test_of_files_that_servos_do_not_hold_the_one_with_their_adapters_name_is_taken(
    table, name, is_taken, says
):
    emulator = table.arm()
    table.write(table.data / name, table.calibrate(emulator, 0))
    table.calibrate(emulator, 50)
    report = table.only()
    assert report.calibration == (table.data / name if is_taken else None)
    assert says in report.sentence


def test_lerobots_file_marks_a_leader_and_is_not_suggested(table):
    emulator = table.arm(kind=STS3215_7V4, volts=7.4)
    folder = table.home / ".cache/huggingface/lerobot/calibration/teleoperators/so_leader"
    table.write(folder / "blue.json", table.calibrate(emulator, 0), lerobot=True)
    report = table.only()
    assert report.role == "leader"
    assert "blue.json is a leader's" in report.because
    assert report.calibration is None
    assert "blue.json" in report.sentence
    gripper = next(s for s in report.suggestions if "gripper" in s.name)
    assert gripper.attributes["gripper_type"] == "leader"
