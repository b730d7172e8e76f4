"""Pollen Robotics' driver, which is written in Rust, on the emulated port: a second opinion.

It holds the interpreter lock for as long as it waits for an answer, so the servos have a process of
their own.
"""

import subprocess
import sys

import pytest
from harness.viam_machine import until_true

pytestmark = pytest.mark.long  # it gives answers a few milliseconds, whatever the machine does
rustypot = pytest.importorskip("rustypot")

IDS = [1, 2, 3, 4, 5, 6]
EMULATE = "from so101_motion.cli import main; main()"


@pytest.fixture(scope="module")
def servos():
    process = subprocess.Popen(
        [sys.executable, "-c", EMULATE, "emulate", "--realtime"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    servos = rustypot.Sts3215PyController(process.stdout.readline().strip(), 1_000_000, 2.0)
    yield servos
    servos.close()
    process.terminate()
    process.communicate(timeout=60.0)


def test_rustypot_finds_all_servos_by_ping_and_by_broadcast(servos):
    assert [servos.ping(i) for i in IDS] == [True] * 6
    assert not servos.ping(7)
    # Scans give the answers a short time of their own, which a busy computer may need for
    # something else.
    until_true(lambda: servos.scan(IDS) == dict.fromkeys(IDS, 777))
    until_true(lambda: servos.broadcast_scan(None) == dict.fromkeys(IDS, 777))


def test_rustypot_reads_what_the_servos_measure(servos):
    assert servos.sync_read_firmware_major_version(IDS) == [3] * 6
    assert servos.sync_read_present_voltage(IDS) == pytest.approx([120] * 6, abs=2)
    assert servos.sync_read_present_temperature(IDS) == [25] * 6
    q = servos.sync_read_present_position(IDS)
    assert [q[0], q[4], q[5]] == pytest.approx([0.0] * 3, abs=0.01)
    assert q[1:4] == pytest.approx([-1.6, 1.5, 1.15], abs=0.2), "folded, as it lies on a table"
    assert servos.sync_read_status(IDS) == [0] * 6
    raw = servos.sync_read_raw_data_with_error(IDS, 56, 15)
    assert [(len(data), error) for data, error in raw] == [(15, 0)] * 6
