"""Travels on the circle of ticks, and homing offsets."""

from itertools import pairwise

import pytest

from so101_motion.calib.procedure.travel import (
    TravelArc,
    TravelRecorder,
    fit,
    full_turn,
    homing_offset,
    representable,
)


def swept(*ticks, dt=0.01):
    """A sweep that saw these readings, one every ``dt`` seconds."""
    sweep = TravelRecorder()
    for i, tick in enumerate(ticks):
        sweep.feed(i * dt, tick % 4096)
    return sweep


def line(*corners, step=25):
    """Readings on straight lines between corners, three at each."""
    ticks = [corners[0]] * 3
    for start, end in pairwise(corners):
        ticks += [*range(start, end, step if end > start else -step), end, end, end]
    return ticks


# Sweeps


def test_a_sweep_keeps_both_ends():
    assert swept(*line(2000, 3400, 700)).arc == TravelArc(700, 2700)


def test_a_sweep_across_the_seam_goes_on_below_zero_or_above_4095():
    assert swept(*line(4000, 4500, 3000)).arc == TravelArc(3000, 1500)
    assert swept(*line(100, 1500, -300)).arc == TravelArc(-300, 1800)


def test_a_single_reading_may_cross_the_seam_in_one_jump():
    assert swept(*[3900] * 3, *[300] * 3).arc == TravelArc(-196, 496)


def test_one_wrong_reading_adds_nothing():
    right = line(2000, 2600, 1500)
    for wrong in (0, 1, 3648, 4048, 4095, 2000 + 2048):
        spoiled = [*right[:40], wrong, *right[40:]]
        assert swept(*spoiled).arc == TravelArc(1500, 1100)


def test_two_readings_are_no_travel_yet():
    assert swept(100, 100).arc is None
    assert swept(100, 100, 100).arc == TravelArc(100, 0)


def test_a_whole_turn_and_more_is_a_whole_turn():
    assert swept(*line(0, 9000)).arc.travel == 4095


def test_after_a_pause_the_way_in_between_is_unknown_until_it_is_passed():
    sweep = swept(*line(1000, 1100))
    for i in range(3):
        sweep.feed(10.0 + 0.01 * i, 3300)
    assert sweep.arc == TravelArc(3300 - 4096, 1896, 1795)  # the shorter of two guesses
    for i, ticks in enumerate(line(3300, 1000)):
        sweep.feed(10.03 + 0.01 * i, ticks)
    assert sweep.arc == TravelArc(1000, 2300)


def test_a_short_pause_is_bridged():
    sweep = swept(*line(1000, 1100))
    for i in range(3):
        sweep.feed(0.3 + 0.01 * i, 1500)
    assert sweep.arc == TravelArc(1000, 500)


@pytest.mark.parametrize(
    ("arc", "ticks", "unrolled"),
    [
        (TravelArc(700, 2700), 700, 700),
        (TravelArc(-300, 1800), 4000, -96),
        (TravelArc(3000, 1500), 100, 4196),
        (TravelArc(-300, 1800), 1700, 1700),
    ],
)
def test_readings_are_shown_in_the_turn_of_the_travel(arc, ticks, unrolled):
    assert arc.unrolled(ticks) == unrolled


# Homing offsets


@pytest.mark.parametrize("encoder", [0, 1, 2046, 2047, 2048, 4093, 4094, 4095])
def test_a_homing_offset_puts_the_pose_in_the_middle(encoder):
    offset = homing_offset(encoder)
    assert abs(offset) <= 2047
    assert (encoder - offset) % 4096 in (2047, 2048)


def test_only_one_place_of_the_circle_is_a_tick_off():
    off = [encoder for encoder in range(4096) if (encoder - homing_offset(encoder)) % 4096 != 2047]
    assert off == [4095]


def test_an_offset_of_newer_firmware_has_an_equal_that_every_servo_holds():
    assert representable(3000) == 3000 - 4096
    assert representable(-4000) == 96
    assert representable(2048) == 2047  # a tick off
    assert representable(-7) == -7


def test_a_travel_that_fits_keeps_the_offset_of_the_pose():
    found = fit(TravelArc(700, 2700), offset=-150, home=2047)
    assert (found.homing_offset, found.lower, found.upper, found.home) == (-150, 700, 3400, 2047)


def test_a_travel_across_the_seam_is_moved_to_the_middle():
    found = fit(TravelArc(-300, 2700), offset=1000, home=2047)
    assert (found.homing_offset, found.lower, found.upper, found.home) == (3, 697, 3397, 3044)


def test_a_travel_next_to_the_seam_is_moved_as_well():
    assert fit(TravelArc(10, 2700), offset=0, home=2047).lower == 697
    assert fit(TravelArc(4095 - 2710, 2700), offset=0, home=2047).lower == 697
    assert fit(TravelArc(64, 2700), offset=0, home=2047).lower == 64


def test_the_widest_travel_still_finds_a_place():
    found = fit(TravelArc(2000, 4000), offset=0, home=2047)
    assert 0 <= found.lower < found.upper <= 4095
    assert found.upper - found.lower == 4000


def test_a_full_turn_has_its_zero_in_the_middle():
    found = full_turn(offset=5, home=2047)
    assert (found.lower, found.upper, found.home) == (0, 4095, 2047)
