"""Motor setup over a real pseudo-terminal, bytes and adapter as slow as in life."""

import time
from contextlib import nullcontext

import pytest
from harness.lent_bus import PortAccess

from so101_motion.calib.motors.motor_setup import MotorSetup
from so101_motion.common.errors import MotorSetupError
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.emulator import registers as emulated
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.pty_port import Pacing

LIFELIKE = Pacing(realtime=True, latency=0.002)
AT_MOST = 3.0  # [s]


@pytest.fixture
def loose():
    """Makes one servo on an adapter, talking at a rate, and its setup."""
    made = []

    def make(baud, ids=None):
        options = EmulatorOptions(ids=ids or {6: 1}, calibrated=False, pacing=LIFELIKE)
        emulator = Emulator(options)
        made.append(emulator)
        memory = emulator.world.servo("6").memory
        memory.keep(emulated.BAUD, reg.BAUDS.index(baud))
        access = PortAccess(emulator.port)
        made.append(access)
        return emulator, MotorSetup(lambda: nullcontext(access))

    yield make
    for one in reversed(made):
        one.close()


def fastest(call):
    """What ``call`` takes [s]; the best of three, as others may have had the processor."""
    took = []
    for _ in range(3):
        begin = time.monotonic()
        call()
        took.append(time.monotonic() - begin)
        if took[-1] < AT_MOST:
            break
    return min(took)


def test_a_servo_at_the_likeliest_rate_is_found_at_once(loose):
    _, setup = loose(1_000_000)
    assert fastest(lambda: setup.discover("gripper")) < 1.0


def test_a_servo_at_the_rate_that_is_looked_at_last_is_found_within_three_seconds(loose):
    _, setup = loose(76_800)
    found = []
    assert fastest(lambda: found.append(setup.discover("gripper"))) < AT_MOST
    assert found[-1].baud == 76_800


def test_silence_is_reported_within_three_seconds(loose):
    emulator, setup = loose(1_000_000)
    emulator.world.power(0.0)

    def look():
        with pytest.raises(MotorSetupError, match="power supply"):
            setup.discover("gripper")

    assert fastest(look) < AT_MOST
