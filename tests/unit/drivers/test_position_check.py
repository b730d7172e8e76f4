import math

import pytest

from so101_motion.drivers.bus.ticks import TICKS_PER_RAD
from so101_motion.drivers.position_check import CLOSE, FASTEST, SCATTER, KnownPosition

DEG = math.radians(1.0) * TICKS_PER_RAD


def known_at(ticks):
    position = KnownPosition()
    position.found(ticks, 0.0, is_sure=True)
    return position


@pytest.fixture
def belief():
    """A joint known to be at 1000 ticks at 0 s."""
    return known_at(1000)


def judge(belief, ticks, t):
    return belief.judge(round(ticks), t, t)


@pytest.mark.parametrize("ticks", [-1, -32000, 4096, 32767])
def test_a_position_that_no_encoder_has_is_never_believed(belief, ticks):
    assert not judge(belief, ticks, 9.0)


@pytest.mark.parametrize("off", [3.0 * DEG, -45.0 * DEG, 170.0 * DEG])
def test_one_position_that_the_joint_cannot_have_reached_is_not_believed(belief, off):
    assert not judge(belief, 1000 + off, 0.01)
    assert judge(belief, 1001, 0.02)
    assert belief.is_sure


def test_a_wrong_position_is_not_believed_however_often_it_comes(belief):
    believed = [t for t in range(1, 20) if judge(belief, 1000 + 90.0 * DEG, 0.01 * t)]
    assert believed[0] >= 100.0 * (90.0 * DEG - SCATTER) / FASTEST - 1e-9


def test_what_is_seen_after_a_jump_is_believed_as_soon_as_it_is_possible_and_seen_again(belief):
    for t in (0.007, 0.008, 0.009):
        assert not judge(belief, 1000 + 10.0 * DEG, t)
    assert not judge(belief, 1000 + 10.0 * DEG, 0.010)  # not yet possible
    assert judge(belief, 1000 + 10.0 * DEG, 0.011)
    assert belief.is_sure


def test_after_a_pause_one_is_possible_and_the_fourth_or_one_as_before_makes_it_sure(belief):
    before = known_at(1000)
    assert judge(before, 1000 + 15.0 * DEG, 0.05)
    assert not before.is_sure
    assert judge(before, 1001, 0.05)
    assert before.is_sure
    for ticks in (1000, 1001, 999):
        assert judge(belief, ticks + 15.0 * DEG, 0.05)
        assert not belief.is_sure
    assert judge(belief, 1000 + 15.0 * DEG, 0.05)
    assert belief.is_sure


def test_a_joint_that_flicks_through_its_play_is_believed_but_not_yet_sure(belief):
    ticks = (1007, 1014, 1010, 1025)  # an elbow in motion, as seen of an emulated one
    believed = [judge(belief, each, 0.01 * k) for k, each in enumerate(ticks, start=1)]
    assert all(believed)
    assert not belief.is_sure
    assert judge(belief, 1032, 0.05)
    assert judge(belief, 1039, 0.06)
    assert judge(belief, 1046, 0.07)
    assert belief.is_sure


@pytest.mark.parametrize("seam", [4094, 0])
def test_the_seam_is_a_place_like_any_other(seam):
    belief = known_at(seam)
    assert judge(belief, (seam + 3) % 4096, 0.01)
    assert judge(belief, (seam - 3) % 4096, 0.02)


@pytest.mark.parametrize(
    "speeds",
    [
        (0, 110, 220, 330, 350, 350, 0, 0, -110, -220, -330, 0),  # a hand stops dead
        (0, 120, 240, 360, 480, 600, 674, 674, 0, 0),  # a fall onto the table
    ],
)
def test_a_joint_that_accelerates_hard_and_stops_dead_is_believed_throughout(belief, speeds):
    q, t = 1000.0, 0.0
    for speed in speeds:  # [deg/s], every 10 ms
        q, t = q + 0.01 * speed * DEG, t + 0.01
        assert judge(belief, q, t)
    assert belief.is_sure


def test_an_answer_that_may_be_late_is_given_the_time_it_took(belief):
    for k, off in enumerate((1.0, 3.0, 5.0, 7.0), start=1):
        assert judge(belief, 1000 + off * DEG, 0.01 * k)
    far = round(1000 + 12.0 * DEG + CLOSE)
    assert not belief.judge(far, 0.05, 0.05), "in time it is not believed"
    assert belief.judge(far, 0.05, 0.06)
