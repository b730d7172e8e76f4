"""Motor setup over a real pseudo-terminal, bytes and adapter as slow as in life."""

import threading
import time
from contextlib import contextmanager, nullcontext

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


@contextmanager
def lateness():
    """How long a thread of this process waits for the processor meanwhile [s], in a list."""
    over, late = threading.Event(), [0.0]

    def doze():
        while not over.is_set():
            begin = time.monotonic()
            time.sleep(0.01)
            late[0] += time.monotonic() - begin - 0.01

    thread = threading.Thread(target=doze)
    thread.start()
    yield late
    over.set()
    thread.join()


def is_quick(call, at_most=AT_MOST):
    """Whether ``call`` is over within that time [s], but for what other programs took of it; once
    of ten times is enough."""
    for _ in range(10):
        begin = time.monotonic()
        with lateness() as late:
            call()
            took = time.monotonic() - begin - late[0]
        if took < at_most:
            return True
    return False


def test_a_servo_at_the_likeliest_rate_is_found_at_once(loose):
    _, setup = loose(1_000_000)
    assert is_quick(lambda: setup.discover("gripper"), 1.0)


def test_a_servo_at_the_rate_that_is_looked_at_last_is_found_within_three_seconds(loose):
    _, setup = loose(76_800)
    found = []
    assert is_quick(lambda: found.append(setup.discover("gripper")))
    assert found[-1].baud == 76_800


def test_silence_is_reported_within_three_seconds(loose):
    emulator, setup = loose(1_000_000)
    emulator.world.power(0.0)

    def look():
        with pytest.raises(MotorSetupError, match="power supply"):
            setup.discover("gripper")

    assert is_quick(look)
