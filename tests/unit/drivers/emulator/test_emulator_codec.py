import pytest

from so101_motion.drivers.emulator.codec import Code, Listener, State, frame

# The packets printed in the manufacturer's protocol manual.
GOLDEN = [
    (frame(1, Code.PING), "FF FF 01 02 01 FB"),
    (frame(1, Code.READ, bytes((56, 2))), "FF FF 01 04 02 38 02 BE"),
    (frame(1, 0, bytes.fromhex("18 05")), "FF FF 01 04 00 18 05 DD"),
    (frame(1, Code.WRITE, bytes.fromhex("2A 00 08 00 00 E8 03")),
     "FF FF 01 09 03 2A 00 08 00 00 E8 03 D5"),
    (frame(1, Code.CLEAR_TURNS), "FF FF 01 02 0A F2"),
    (frame(254, Code.SYNC_WRITE,
           bytes((42, 6)) + b"".join(bytes((i,)) + bytes.fromhex("00 08 00 00 E8 03")
                                     for i in (1, 2, 3, 4))),
     "FF FF FE 20 83 2A 06 01 00 08 00 00 E8 03 02 00 08 00 00 E8 03 "
     "03 00 08 00 00 E8 03 04 00 08 00 00 E8 03 58"),
]  # fmt: skip


@pytest.mark.parametrize(("packet", "golden"), GOLDEN)
def test_packets_are_those_of_the_manual(packet, golden):
    assert packet == bytes.fromhex(golden)


# What a listener makes of bytes: where it ends up, and what it heard (id, code, params).
ROWS = [
    ("", State.HUNT, []),
    ("FF", State.HUNT, []),
    ("FF FF", State.HUNT, []),
    ("FF FF 01", State.LENGTH, []),
    ("FF FF 01 02", State.CODE, []),
    ("FF FF 01 02 01", State.CHECKSUM, []),
    ("FF FF 01 02 01 FB", State.HUNT, [(1, 1, "")]),
    ("FF FF 01 04 02 38", State.PARAMS, []),
    ("FF FF 01 04 02 38 02", State.CHECKSUM, []),
    ("FF FF 01 04 02 38 02 BE", State.HUNT, [(1, 2, "38 02")]),
    ("FF FF 01 02 01 FC", State.HUNT, []),  # wrong checksum
    ("FF FF 01 01", State.HUNT, []),  # too short to be a packet
    ("FF FF FF 01 02 01 FB", State.HUNT, [(1, 1, "")]),  # a header byte too many
    ("00 12 FF FF 01 02 01 FB", State.HUNT, [(1, 1, "")]),  # noise before
    ("FF 01 FF FF 01 02 01 FB", State.HUNT, [(1, 1, "")]),  # half a header before
    ("FF FF 01 09 03 2A FF FF 02 02 01 FA", State.HUNT, [(2, 1, "")]),  # a header inside wins
    ("FF FF FE 83 02", State.HUNT, []),  # more parameters than fit the servo's buffer
    ("FF FF FE 83 83", State.PARAMS, []),  # but a sync write may be that long
    ("FF FF 01 02 01 FB FF FF 02 02 01 FA", State.HUNT, [(1, 1, ""), (2, 1, "")]),
    ("FF FF 01 02 63 99", State.HUNT, [(1, 0x63, "")]),  # unknown code, still a packet
]


@pytest.mark.parametrize("chunk", [100, 1])
@pytest.mark.parametrize(("data", "state", "events"), ROWS)
def test_listener_follows_its_table_however_bytes_are_cut(data, state, events, chunk):
    listener, data = Listener(), bytes.fromhex(data)
    pieces = [data[i : i + chunk] for i in range(0, len(data), chunk)]
    heard = [each for piece in pieces for each in listener.hear(piece)]
    assert listener.state is state
    assert [(i.servo_id, i.code, i.params) for i in heard] == [
        (servo_id, code, bytes.fromhex(params)) for servo_id, code, params in events
    ]
