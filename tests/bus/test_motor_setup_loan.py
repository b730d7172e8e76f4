"""Motor setup on the bus that a rig lends; afterwards the arm can be opened."""

from contextlib import contextmanager

import pytest
from harness.emulated_rig import hardware_bench

from so101_motion.calib.record.record import SERVO_IDS
from so101_motion.common.errors import MotorSetupError
from so101_motion.drivers.emulator import registers as emulated
from so101_motion.setup.motor_operation import MotorOperation

HALF_DONE = {1: 1, 2: 2, 3: 1, 4: 4, 5: 5, 6: 1}
START = (0.1, -0.4, 0.5, -0.2, 0.4, 0.3)


class Bench:
    """A kit on a port, and its setup.

    Attributes:
        setup: Borrows the bus for each request.
    """

    def __init__(self, hardware):
        self._hardware = hardware
        self._rig = hardware.open(servo_ids=None, gripper_id=None)
        self.setup = MotorOperation(self._borrow)

    @contextmanager
    def _borrow(self):
        loan = self._rig.lend_bus("motor setup")
        try:
            yield loan
        finally:
            loan.abandon()

    @property
    def servos(self):
        return self._hardware.world.servos

    def plug(self, *places):
        for place in range(1, 7):
            world = self._hardware.world
            (world.connect if place in places else world.disconnect)(str(place))
        self._hardware.advance(0.9)
        self._hardware.emulator.advance()

    def open(self):
        return self._hardware.open()


@pytest.fixture
def bench(tmp_path):
    with hardware_bench(tmp_path, ids=HALF_DONE, calibrated=False, q_start=START) as hardware:
        yield Bench(hardware)


def test_a_kit_becomes_an_arm(bench):
    bench.servos[2].memory.keep(emulated.BAUD, 4)  # somebody had tried another rate
    for joint in ("gripper", "elbow_flex"):
        bench.plug(SERVO_IDS[joint])
        bench.setup.discover(joint)
        bench.setup.assign(joint)
    bench.plug(1, 2, 3, 4, 5, 6)
    found = bench.setup.verify()
    assert found.ok, found.sentence
    assert [servo.servo_id for servo in bench.servos] == [1, 2, 3, 4, 5, 6]
    assert len(bench.open().servos.setups) == 6


def test_a_chain_that_is_not_set_up_yet_is_refused(bench):
    with pytest.raises(MotorSetupError) as caught:
        bench.setup.discover("gripper")
    assert caught.value.problem == "several servos"
    assert bench.setup.state.motors["gripper"].state == "failed"
    assert [servo.servo_id for servo in bench.servos] == list(HALF_DONE.values())
