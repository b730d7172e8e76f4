"""Motor setup when answers are lost and plugs are pulled."""

import pytest
from harness.lent_bus import loose

from so101_motion.common.errors import (
    BusError,
    MotorSetupError,
)
from so101_motion.drivers.bus import registers as reg

KIT = dict.fromkeys(range(1, 7), 1)
"""Six servos as they come: all have id 1."""


@pytest.mark.parametrize("seed", range(20))
def test_lost_and_garbled_answers_cost_retries_or_a_plain_error_and_never_an_id(seed):
    bus, setup = loose(1, 115_200)
    bus.faults.__init__(seed=seed, loss=0.05, corrupt=0.03, request_loss=0.03)
    for _ in range(30):
        try:
            done = setup.assign("gripper")
        except (MotorSetupError, BusError):
            assert setup.state.motors["gripper"].state == "failed"
            continue
        assert done["new_id"] == 6
        break
    bus.faults.__init__()
    assert bus.holds(6, reg.ID, after_power_off=True) == 6
    assert bus.holds(6, reg.BAUD_RATE, after_power_off=True) == 0
    assert setup.assign("gripper")["changed"] == []


@pytest.mark.parametrize("lost", range(20))
def test_a_moment_of_silence_never_means_that_the_id_was_not_taken(lost):
    bus, setup = loose()
    jobs = iter(range(1000))

    def be_silent_once():
        bus.plug(*(() if next(jobs) == lost else (6,)))

    bus.before = be_silent_once
    problem = None
    try:
        setup.assign("gripper")
    except BusError:
        pass
    except MotorSetupError as error:
        problem = error.problem
    assert problem != "not taken"


class _PlugPulled(Exception):
    pass


def test_it_can_be_taken_up_again_wherever_it_was_cut_off():
    for cut in range(1, 40):
        bus, setup = loose(1, 57_600)
        bus.set(6, homing_offset=500)
        jobs = iter(range(1, 1000))

        def pull(jobs=jobs, cut=cut):
            if next(jobs) == cut:
                raise _PlugPulled

        bus.before = pull
        try:
            setup.assign("gripper", current_baudrate=57_600)
        except _PlugPulled:
            pass
        else:
            break
        bus.before = lambda: None
        bus.wire.baud = 1_000_000
        assert setup.assign("gripper")["new_baudrate"] == 1_000_000
        assert bus.holds(6, reg.ID, after_power_off=True) == 6
        assert bus.holds(6, reg.HOMING_OFFSET, after_power_off=True) == 0
        assert bus.holds(6, reg.LOCK) == 1
    assert cut > 10, "it was cut off at every job"


# The view
