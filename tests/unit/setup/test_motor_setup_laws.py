"""No servo's id is ever changed unasked, whatever is plugged in and requested."""

from harness.lent_bus import LentBus
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.calib.motors.setup_view import SETUP_ORDER
from so101_motion.calib.record.record import SERVO_IDS
from so101_motion.common.errors import So101Error
from so101_motion.drivers.bus import registers as reg
from so101_motion.setup.motor_operation import MotorOperation

RATES = (1_000_000, 115_200, 38_400)
joints = st.sampled_from(SETUP_ORDER)

kits = st.lists(
    st.tuples(st.sampled_from([1, 1, 1, 2, 5, 6, 17, 253]), st.sampled_from(RATES)),
    min_size=6,
    max_size=6,
)
requests = st.lists(
    st.one_of(
        st.tuples(st.just("plug"), st.sets(st.integers(1, 6), max_size=2)),
        st.tuples(st.just("plug"), st.sets(st.integers(1, 6))),
        st.tuples(st.just("discover"), joints),
        st.tuples(st.just("assign"), joints),
        st.tuples(st.just("assign"), joints),
        st.tuples(st.just("skip"), joints),
        st.tuples(st.just("verify"), st.none()),
        st.tuples(st.just("reset"), st.none()),
    ),
    max_size=12,
)


def state(bus):
    """Id and rate of every servo, by place."""
    return {
        place: (servo.servo_id, servo.baud)
        for place, servo in enumerate(bus.world.servos, start=1)
    }  # fmt: skip


def carry_out(setup, name, argument):
    try:
        getattr(setup, name)(*(() if argument is None else (argument,)))
    except So101Error as error:
        return error
    return None


@settings(max_examples=100)
@given(kits, requests)
def test_only_a_servo_that_is_alone_is_changed_and_only_as_asked(kit, wanted):
    bus = LentBus(calibrated=False)
    for place, (servo_id, baud) in enumerate(kit, start=1):
        bus.set(place, id=servo_id, baud_rate=reg.BAUDS.index(baud))
    setup = MotorOperation(bus.lent)
    plugged = set(range(1, 7))
    for name, argument in wanted:
        if name == "plug":
            plugged = argument
            bus.plug(*argument)
            continue
        before = state(bus)
        error = carry_out(setup, name, argument)
        changed = {place for place, now in state(bus).items() if now != before[place]}
        if changed:
            assert name == "assign"
            assert changed == plugged
            assert len(plugged) == 1
        if name == "assign" and error is None:
            (place,) = plugged
            assert state(bus)[place] == (SERVO_IDS[argument], 1_000_000)
            assert setup.state.motors[argument].state == "configured"
        if name == "assign" and len(plugged) != 1:
            assert error is not None
        assert bus.wire.baud == 1_000_000, "the port is back at its own rate"
        assert setup.state.doing == ""
        assert setup.state.next_step
