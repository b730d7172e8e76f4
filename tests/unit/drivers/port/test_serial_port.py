import os
import threading
import time
from dataclasses import dataclass

import pytest

from so101_motion.common.errors import PortUnavailable
from so101_motion.drivers.port import serial_port as port_module
from so101_motion.drivers.port.port_list import programs_using
from so101_motion.drivers.port.serial_port import PortOpener, SerialPort, UsbIdentity, find_again


class Terminal:
    """A pseudo-terminal whose far end a test holds."""

    def __init__(self):
        self.far, self.near = os.openpty()
        self.name = os.ttyname(self.near)

    def unplug(self):
        for fd in (self.far, self.near):
            if fd is not None:
                os.close(fd)
        self.far = self.near = None


@pytest.fixture
def terminal():
    terminal = Terminal()
    yield terminal
    terminal.unplug()


@pytest.fixture
def port(terminal):
    port = SerialPort(terminal.name)
    yield port
    port.close()


def soon():
    return time.monotonic() + 60.0


def test_all_bytes_pass_both_ways(terminal, port):
    every = bytes(range(256))
    port.write(every)
    assert os.read(terminal.far, 1000) == every
    os.write(terminal.far, every)
    assert port.read(soon()) == every


def test_reading_ends_when_nothing_comes_and_costs_no_processor_time(port):
    wall, cpu = time.monotonic(), time.thread_time()
    assert port.read(time.monotonic() + 0.1) == b""
    assert time.monotonic() - wall >= 0.1
    assert time.thread_time() - cpu < 0.02


def test_reading_wakes_as_soon_as_a_byte_comes(terminal, port):
    timer = threading.Timer(0.02, os.write, (terminal.far, b"\x01"))
    timer.start()
    assert port.read(soon()) == b"\x01"
    timer.join()


def test_a_moment_that_has_passed_still_brings_what_is_there_and_discarded_input_is_gone(
    terminal, port
):
    os.write(terminal.far, b"\x07")
    assert port.read(0.0) == b"\x07"
    assert port.read(0.0) == b""
    os.write(terminal.far, b"stale")
    port.discard()
    os.write(terminal.far, b"new")
    assert port.read(soon()) == b"new"


def test_a_port_in_use_is_refused_under_each_of_its_names_and_the_holder_is_named(
    terminal, port, tmp_path
):
    with pytest.raises(PortUnavailable, match=rf"in use by .*process {os.getpid()}, this program"):
        SerialPort(terminal.name)
    link = tmp_path / "by-id"
    link.symlink_to(terminal.name)
    with pytest.raises(PortUnavailable, match="in use") as info:
        SerialPort(str(link))
    assert info.value.port == str(link)
    assert programs_using(str(link))


def test_a_closed_port_can_be_opened_again(terminal, port):
    port.close()
    port.close()
    SerialPort(terminal.name).close()


BRIDGE = "socat pty,link=/tmp/so101,rawer tcp:pi:5760,"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("ttyACM0", "no such port; check the USB cable"),
        ("socket://pi:5760", BRIDGE),
        ("rfc2217://pi:5760?logging=debug", BRIDGE),
        ("file", "is not a serial port; list the ports with"),
    ],
)
def test_what_is_no_port_here_is_reported_with_what_to_do(name, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(PortUnavailable, match=says):
        SerialPort(name)


@pytest.mark.parametrize("use", [
    lambda port: port.read(soon()), lambda port: port.write(b"\x01"), lambda port: port.discard(),
], ids=["read", "write", "discard"])  # fmt: skip
def test_a_port_that_goes_away_is_noticed(terminal, port, use):
    terminal.unplug()
    with pytest.raises(PortUnavailable, match="went away"):
        use(port)


def test_going_away_ends_a_read_that_waits(terminal, port):
    timer = threading.Timer(0.02, terminal.unplug)
    timer.start()
    with pytest.raises(PortUnavailable):
        port.read(soon())
    timer.join()


@dataclass
class Listed:
    """What pyserial tells of a port."""

    device: str
    vid: int | None = 0x1A86
    pid: int | None = 0x55D3
    serial_number: str | None = None


OURS = UsbIdentity(vendor=0x1A86, product=0x55D3, serial_number="5A68")


@pytest.fixture
def plugged(monkeypatch):
    """Sets which adapters the system lists."""
    ports = []
    monkeypatch.setattr(port_module.list_ports, "comports", lambda: list(ports))
    return ports


def test_an_opener_opens_the_same_adapter_at_another_rate(plugged, terminal):
    plugged += [Listed(terminal.name, serial_number="5A68")]
    opener = PortOpener(terminal.name, 500_000)
    for asked, baud in ((250_000, 250_000), (None, 500_000)):
        port = opener(asked)
        assert port.baud == baud
        port.close()
    plugged[0] = Listed(terminal.name, serial_number="other")
    with pytest.raises(PortUnavailable, match="not plugged in"):
        opener(250_000)


@pytest.mark.parametrize(
    ("there", "usb", "found"),
    [
        ({}, None, "/dev/ttyACM0"),
        ({"/dev/ttyACM0": "other", "/dev/ttyACM1": "5A68"}, OURS, "/dev/ttyACM1"),
        ({"/dev/ttyACM0": "5A68"}, OURS, "/dev/ttyACM0"),
        ({"/dev/ttyACM0": "other"}, OURS, None),
    ],
)
def test_an_adapter_that_is_known_is_found_wherever_it_is_and_no_other_is(
    plugged, there, usb, found
):
    plugged += [Listed(name, serial_number=number) for name, number in there.items()]
    assert find_again("/dev/ttyACM0", usb) == found
