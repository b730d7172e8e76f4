import pytest
from hypothesis import given
from hypothesis import strategies as st
from so101_viewer.page.plan_view import RATES, Playback


def test_a_new_plan_stands_at_its_goal():
    playback = Playback()
    playback.load(3.0)
    assert playback.t == 3.0
    assert playback.rate is None


@given(rate=st.sampled_from(RATES), steps=st.lists(st.floats(0.0, 0.5), min_size=1, max_size=20))
def test_it_runs_as_fast_as_it_was_told_and_never_beyond_the_end(rate, steps):
    playback = Playback()
    playback.load(3.0)
    playback.play(rate)
    assert playback.t == 0.0
    now = 100.0
    playback.advance(now)
    for step in steps:
        now += step
        playback.advance(now)
    assert playback.t == pytest.approx(min(rate * sum(steps), 3.0), abs=1e-6)


def test_dragging_and_the_same_rate_again_let_it_stand():
    playback = Playback()
    playback.load(3.0)
    playback.play(1.0)
    playback.play(1.0)
    assert playback.rate is None
    playback.play(1.0)
    playback.seek(7.0)
    assert playback.t == 3.0
    assert not playback.advance(1.0)


def test_another_rate_goes_on_from_where_it_is():
    playback = Playback()
    playback.load(3.0)
    playback.seek(1.0)
    playback.play(1.0)
    playback.advance(0.0)
    playback.advance(0.5)
    playback.play(2.0)
    playback.advance(0.6)
    playback.advance(0.7)
    assert playback.t == pytest.approx(1.7)
