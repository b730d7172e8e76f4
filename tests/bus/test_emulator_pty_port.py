"""The emulator on a pseudo-terminal: plugging, locks, timing, and the command line around it."""

import fcntl
import os
import queue
import re
import select
import struct
import termios
import threading
from contextlib import contextmanager
from typing import get_args

import pytest
import serial
from harness.heard_port import open_heard
from harness.things_around import around, cube

from so101_motion.common.errors import NoReply, PortUnavailable
from so101_motion.drivers.bus import registers as known
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.codec import BROADCAST, Code, frame
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import FaultKind, parse_fault
from so101_motion.drivers.emulator.pty_port import Pacing
from so101_motion.drivers.emulator.run import TYPED, run_emulator
from so101_motion.rig.things import things_in

PING = frame(1, Code.PING)
PONG = bytes.fromhex("FF FF 01 02 00 FC")
SYNC_READ = frame(BROADCAST, Code.SYNC_READ, bytes((56, 2, 1, 2, 3, 4, 5, 6)))
_TIOCGEXCL = 0x80045440


@pytest.fixture
def link(tmp_path):
    return tmp_path / "so101"


@pytest.fixture
def make_emulator(clock):
    made = []

    def make(**options):
        emulator = Emulator(EmulatorOptions(**options), now=clock.now)
        made.append(emulator)
        return emulator

    yield make
    for emulator in made:
        emulator.close()


def open_port(emulator, timeout=30.0):
    return serial.Serial(emulator.port, 1_000_000, timeout=timeout)


def ask(port, request, count):
    port.write(request)
    return port.read(count)


def is_silent(port, request):
    patience, port.timeout = port.timeout, 0.03
    heard = ask(port, request, 1)
    port.timeout = patience
    return heard == b""


def first_chunk(port, request):
    """What one read gives once anything has arrived."""
    port.write(request)
    assert select.select([port.fileno()], [], [], 30.0)[0]
    return os.read(port.fileno(), 4096)


def test_every_byte_value_survives_the_way_there_and_back(make_emulator):
    """Control characters above all: a terminal that is not raw eats or translates them."""
    with open_port(make_emulator()) as port:
        for value in range(255):
            params = bytes((reg.GOAL_TIME.address, value, 0))
            assert ask(port, frame(1, Code.WRITE, params), 6) == PONG
            reply = ask(port, frame(1, Code.READ, bytes((reg.GOAL_TIME.address, 1))), 7)
            assert reply[5] == value


def test_unplugging_ends_reads_and_writes_and_plugging_in_brings_the_link_back(make_emulator, link):
    emulator = make_emulator(link=link)
    port = open_port(emulator)
    assert ask(port, PING, 6) == PONG
    emulator.unplug()
    assert not link.is_symlink()
    with pytest.raises(serial.SerialException):
        ask(port, PING, 6)
    port.close()
    emulator.plug()
    with open_port(emulator) as again:
        assert ask(again, PING, 6) == PONG


def test_port_can_be_unplugged_in_the_middle_of_traffic(make_emulator, link):
    emulator, fault = make_emulator(link=link), parse_fault("unplug")
    for _ in range(10):
        with open_port(emulator) as port:
            port.write(SYNC_READ * 20)
            emulator.begin(fault)
        emulator.end(fault)
    with open_port(emulator) as port:
        assert ask(port, PING, 6) == PONG


def test_lock_of_a_client_that_is_gone_does_not_stay(make_emulator):
    emulator = make_emulator()
    with open_port(emulator) as port:
        fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
        assert ask(port, PING, 6) == PONG
    fd = os.open(emulator.port, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(fd, PING)  # the answer comes after the thread has seen the other one go
        assert select.select([fd], [], [], 30.0)[0]
        locked = struct.unpack("i", fcntl.ioctl(fd, _TIOCGEXCL, b"\0\0\0\0"))[0]
        assert not locked
    finally:
        os.close(fd)


def test_adapter_latency_collects_the_replies_of_a_sync_read(make_emulator):
    emulator = make_emulator(pacing=Pacing(realtime=True, latency=0.02))
    with open_port(emulator) as port:
        assert len(first_chunk(port, SYNC_READ)) == 6 * 8


def test_a_reply_is_lost_when_the_client_has_changed_its_rate_meanwhile(make_emulator):
    emulator = make_emulator(pacing=Pacing(realtime=True, latency=1.5))  # bears a stall of 1.4 s
    with open_port(emulator, timeout=2.0) as port:
        port.write(PING)
        threading.Event().wait(0.1)  # the servo answers, the adapter still holds it
        port.baudrate = 500_000
        assert port.read(6) == b""
        port.baudrate, port.timeout = 1_000_000, 30.0
        assert ask(port, PING, 6) == PONG


def test_client_that_never_reads_blocks_nobody(make_emulator):
    emulator = make_emulator()
    with open_port(emulator) as deaf:
        for _ in range(60):
            deaf.write(SYNC_READ * 10)
    with open_port(emulator, timeout=0.05) as port:
        assert any(PONG in ask(port, PING, 4096) for _ in range(1000))


def test_help_has_every_kind_of_fault_and_examples_that_can_be_typed():
    examples = re.findall(r"^  (?:end )?([a-z_]\S*)", TYPED, re.MULTILINE)
    kinds = {parse_fault(each, ends=True).kind for each in examples}
    assert {*get_args(FaultKind)} == kinds | {"request_loss", "corrupt", "duplicate", "late"}
    assert all(each in TYPED for each in get_args(FaultKind))
    assert max(map(len, TYPED.splitlines())) < 79


@pytest.mark.parametrize("text", ["request_loss=1", "twin:1=9"])
def test_faults_that_silence_a_servo_begin_and_end_on_request(make_emulator, clock, text):
    emulator, fault = make_emulator(), parse_fault(text)
    with open_port(emulator) as port:
        emulator.begin(fault)
        assert is_silent(port, PING)
        emulator.end(fault)
        clock.advance(1.0)  # time to boot
        assert ask(port, PING, 6) == PONG


@contextmanager
def program(link, commands, *, things=None, **options):
    """What ``so101 emulate`` runs, with something to type into; what it says, line by line."""
    told, stop = queue.Queue(), threading.Event()
    running = threading.Thread(
        target=run_emulator,
        args=(EmulatorOptions(link=link, **options),),
        kwargs={"announce": told.put, "stop": stop, "commands": commands, "things": things},
        name="so101-emulator-program",
    )
    running.start()
    try:
        assert told.get(timeout=60.0) == str(link)
        yield lambda: told.get(timeout=60.0), told
    finally:
        stop.set()
        running.join(60.0)
    assert not running.is_alive()
    assert not link.is_symlink()


def test_program_announces_its_port_obeys_its_input_and_ends_when_told(link):
    read, write = os.pipe()
    faults, things = (parse_fault("dead:2"),), things_in(around(cube()))
    with (
        os.fdopen(read) as commands,
        os.fdopen(write, "w") as typing,
        program(link, commands, things=things, faults=faults) as (says, _),
        serial.Serial(str(link), 1_000_000, timeout=30.0) as port,
    ):
        assert ask(port, PING, 6) == PONG
        print("volcano", file=typing, flush=True)
        assert "volcano" in says()
        assert is_silent(port, frame(2, Code.PING))
        print("earthquake\nflood\ntake:mug\ntake:cube", file=typing, flush=True)  # all at once
        for words in ("earthquake", "flood", "there are: cube", "cube was taken away"):
            assert words in says()


def test_program_in_the_background_leaves_what_is_typed_to_the_shell(link, monkeypatch):
    """A program that reads its terminal in the background is stopped by the system."""
    group = [os.getpgrp() + 1]
    monkeypatch.setattr(os, "tcgetpgrp", lambda fd: group[0])
    keyboard, near = os.openpty()
    with os.fdopen(near) as commands, program(link, commands) as (says, told):
        os.write(keyboard, b"volcano\n")
        with pytest.raises(queue.Empty):
            told.get(timeout=0.2)
        group[0] = os.getpgrp()
        assert "volcano" in says()
    os.close(keyboard)


def test_a_client_that_serves_its_port_waits_for_late_answers_and_for_nobody_else(link, clock):
    with Emulator(EmulatorOptions(link=link), now=clock.now) as emulator:
        bus = Bus(open_heard(str(link)), reply_timeout=600.0)
        assert bus.ping_all().ids == (1, 2, 3, 4, 5, 6)
        with pytest.raises(NoReply):
            bus.ping(9)
        emulator.bus.faults.late, emulator.bus.faults.lateness = 1.0, 0.01
        assert bus.read(1, known.PRESENT_POSITION) == 2048
        emulator.unplug()
        with pytest.raises(PortUnavailable):
            bus.ping(1)
        emulator.plug()
        emulator.bus.faults.late = 0.0
        bus = Bus(open_heard(str(link)), reply_timeout=600.0)
        assert bus.answering((1, 2, 9)) == [1, 2]
        bus.close()
        with open_port(emulator) as other:  # anybody else is served as ever
            assert ask(other, PING, 6) == PONG
