"""Fixtures of the driver's tests."""

import pytest
from harness.servo_stand import Stand


@pytest.fixture
def make_stand(clock, wired):
    def make(**servos):
        return Stand(clock, wired(now=clock.now, **servos))

    return make


@pytest.fixture
def stand(make_stand):
    stand = make_stand()
    stand.connect()
    return stand
