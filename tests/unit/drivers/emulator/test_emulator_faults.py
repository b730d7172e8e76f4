import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.codec import Code, checksum, frame
from so101_motion.drivers.emulator.faults import FaultEvent, WireFaults, parse_fault

PING = frame(1, Code.PING)


def arrivals(bench, count=400):
    return [bench.raw(PING) for _ in range(count)]


@pytest.mark.parametrize(("lost", "written"), [("loss", 33), ("request_loss", 0)])
def test_lost_replies_belong_to_writes_that_were_done_and_lost_requests_do_not(
    make_bench, lost, written
):
    bench = make_bench(wire=WireFaults(**{lost: 1.0}))
    assert bench.raw(frame(1, Code.WRITE, bytes((reg.ACCELERATION.address, 33)))) == []
    setattr(bench.bus.faults, lost, 0.0)
    assert bench.read(1, reg.ACCELERATION) == written


def test_shares_are_kept(make_bench):
    bench = make_bench(wire=WireFaults(loss=0.2, duplicate=0.1, late=0.3, lateness=0.02))
    replies = arrivals(bench)
    counts = [len(reply) for reply in replies]
    assert counts.count(0) / 400 == pytest.approx(0.2, abs=0.06)
    assert counts.count(2) / 400 == pytest.approx(0.08, abs=0.04)
    late = [one.held for reply in replies for one in reply if one.held]
    assert set(late) == {0.02}
    assert len(late) / sum(counts) == pytest.approx(0.3, abs=0.07)


def test_corruption_flips_one_bit_and_the_checksum_shows_it(make_bench):
    bench = make_bench(wire=WireFaults(corrupt=1.0))
    sound = bytes.fromhex("FF FF 01 02 00 FC")
    for (reply,) in arrivals(bench):
        flipped = [a ^ b for a, b in zip(reply.data, sound, strict=True) if a != b]
        assert len(flipped) == 1
        assert flipped[0].bit_count() == 1
        well_formed = reply.data[:2] == b"\xff\xff" and reply.data[3] == 2
        assert not (well_formed and reply.data[-1] == checksum(reply.data[2:-1]))


def test_same_seed_gives_the_same_faults(make_bench):
    runs = []
    for _ in range(2):
        bench = make_bench(wire=WireFaults(loss=0.3, corrupt=0.3, seed=7))
        runs.append([[reply.data for reply in replies] for replies in arrivals(bench, 100)])
    assert runs[0] == runs[1]


@pytest.mark.parametrize(
    ("text", "event"),
    [
        ("unplug", FaultEvent(kind="unplug")),
        ("dead:3", FaultEvent(kind="dead", servo="3")),
        ("reboot:elbow_flex@5", FaultEvent(kind="reboot", servo="elbow_flex", at=5.0)),
        ("hot:gripper=68", FaultEvent(kind="hot", servo="gripper", value=68.0)),
        ("brownout=3.5@2+0.5", FaultEvent(kind="brownout", value=3.5, at=2.0, duration=0.5)),
        (" loss=0.05 ", FaultEvent(kind="loss", value=0.05)),
        ("twin:2=1", FaultEvent(kind="twin", servo="2", value=1.0)),
        ("object=0.02+3", FaultEvent(kind="object", value=0.02, duration=3.0)),
        ("sweep", FaultEvent(kind="sweep")),
        ("take:cube@2", FaultEvent(kind="take", servo="cube", at=2.0)),
        ("sweep=200", FaultEvent(kind="sweep", value=200.0)),
    ],
)
def test_faults_are_read_from_text(text, event):
    assert parse_fault(text) == event


def test_what_ends_needs_no_value():
    assert parse_fault("hot:gripper", ends=True) == FaultEvent(kind="hot", servo="gripper")
    assert parse_fault("loss", ends=True) == FaultEvent(kind="loss")
    with pytest.raises(ConfigError, match="needs a servo"):
        parse_fault("hot", ends=True)


@pytest.mark.parametrize(
    "text",
    ["", "fire", "dead", "dead:3=2", "hot:3", "loss", "loss=1.5", "unplug:3", "hot:3=4.5.6",
     "loss=x", "only", "pose=3", "take"],
)  # fmt: skip
def test_nonsense_is_refused_with_the_text_in_the_message(text):
    with pytest.raises(ConfigError) as caught:
        parse_fault(text)
    assert repr(text) in str(caught.value)
