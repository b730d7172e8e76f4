from harness.lent_bus import LentBus

from so101_motion.calib.motors.single_servo import LIKELIEST_FIRST, Tuner, find_first_rate


def test_every_rate_is_listened_at_and_the_ports_own_again_and_again():
    bus = LentBus({})
    with Tuner(bus) as tuner:
        assert find_first_rate(tuner, hint=57_600) is None
    assert bus.rates[0] == 57_600
    assert set(bus.rates) == set(LIKELIEST_FIRST)
    assert all(1_000_000 in pair for pair in zip(bus.rates, bus.rates[1:], strict=False))


def test_a_servo_that_is_plugged_in_meanwhile_is_heard_at_the_next_visit():
    bus = LentBus({})
    heard_at = []

    def plug_in_once():
        heard_at.append(bus.wire.baud)
        if len(heard_at) == 5:
            bus.plug(6)

    bus.before = plug_in_once
    with Tuner(bus) as tuner:
        found = find_first_rate(tuner)
    assert (found.baud, found.ids) == (1_000_000, (6,))
    assert len(heard_at) <= 8
