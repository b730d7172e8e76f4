import pytest

from so101_motion.common.errors import PortUnavailable
from so101_motion.drivers.feetech.connection import FIRST_WAIT, LONGEST_WAIT, Connection


class Socket:
    """Where a port can be plugged in.

    Attributes:
        tries: When it was tried to open it [s].
    """

    def __init__(self, clock, port):
        self.clock, self.port = clock, port
        self.plugged, self.tries = True, []

    def open(self):
        self.tries.append(self.clock.now())
        if not self.plugged:
            raise PortUnavailable("/dev/arm", f"failure {len(self.tries)}")
        return self.port


@pytest.fixture
def socket(clock, port):
    return Socket(clock, port)


@pytest.fixture
def connection(clock, socket):
    return Connection(socket.open, clock, names={1: "shoulder_pan"}, reply_timeout=0.0)


def test_the_port_is_opened_when_it_is_first_needed_and_kept(socket, connection):
    assert socket.tries == []
    assert connection.bus() is connection.bus()
    assert len(socket.tries) == 1


def test_tries_come_further_apart_and_between_two_the_last_reason_is_reported(
    clock, socket, connection
):
    socket.plugged = False
    for _ in range(2400):
        with pytest.raises(PortUnavailable) as caught:
            connection.bus()
        assert f"failure {len(socket.tries)}" in str(caught.value)
        clock.advance(0.01)
    gaps = [later - earlier for earlier, later in zip(socket.tries, socket.tries[1:], strict=False)]
    assert gaps == pytest.approx([0.25, 0.5, 1.0, 2.0, 4.0, 5.0, 5.0, 5.0], abs=0.02)
    assert (FIRST_WAIT, LONGEST_WAIT) == (0.25, 5.0)


def test_a_lost_port_is_closed_counted_and_tried_again_soon(clock, port, connection):
    before = connection.bus()
    before.ping(1)
    connection.lost(PortUnavailable("/dev/arm", "gone"))
    assert port.closed
    assert not connection.is_open
    with pytest.raises(PortUnavailable, match="gone"):
        connection.bus()
    clock.advance(FIRST_WAIT)
    assert connection.bus() is not before
    assert connection.losses == 1
    assert connection.bus().counters[1].answers == 1
