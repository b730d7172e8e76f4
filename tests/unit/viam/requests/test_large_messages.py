"""Large messages are checked before they are decoded; small ones are not."""

import pytest
from google.protobuf.message import DecodeError
from hypothesis import given
from hypothesis import strategies as st
from viam.proto.common import (
    DoCommandRequest,
    GeometriesInFrame,
    Geometry,
    Mesh,
    PointCloud,
    RectangularPrism,
    Vector3,
    WorldState,
)
from viam.proto.service.motion import MoveRequest

from so101_motion.common.errors import ConfigError
from so101_motion.viam.requests.large_messages import (
    LARGE,
    LARGEST_REST,
    LARGEST_STRUCT,
    MOST_FIELDS,
    LargeCodec,
    content_of,
    receive_in_pieces,
)

CONTENT = bytes(range(256)) * (LARGE // 128)
BOX = Geometry(label="box", box=RectangularPrism(dims_mm=Vector3(x=5, y=5, z=5)))


def decoded(message):
    return LargeCodec().decode(message.SerializeToString(), type(message))


def around(*geometries):
    groups = [GeometriesInFrame(reference_frame="world", geometries=[each]) for each in geometries]
    return MoveRequest(name="planner", world_state=WorldState(obstacles=groups))


def test_large_contents_are_found_by_their_references():
    mesh = Geometry(label="part", mesh=Mesh(content_type="ply", mesh=CONTENT))
    small = Geometry(label="small", mesh=Mesh(content_type="stl", mesh=b"solid"))
    cloud = Geometry(label="seen", pointcloud=PointCloud(point_cloud=CONTENT[::-1]))
    move = decoded(around(mesh, BOX, small, cloud))

    assert len(move.SerializeToString()) < 1_000
    found = [group.geometries[0] for group in move.world_state.obstacles]
    assert [each.label for each in found] == ["part", "box", "small", "seen"]
    assert content_of(found[0].mesh.mesh) == CONTENT
    assert content_of(found[2].mesh.mesh) == b"solid"
    assert content_of(found[3].pointcloud.point_cloud) == CONTENT[::-1]
    assert found[0].mesh.content_type == "ply"
    assert found[1] == BOX


def test_a_message_of_many_fields_is_refused():
    boxes = GeometriesInFrame(geometries=[BOX] * (MOST_FIELDS + 1))
    with pytest.raises(ConfigError, match=f"over {MOST_FIELDS} fields"):
        decoded(MoveRequest(world_state=WorldState(obstacles=[boxes])))


def test_a_thousand_geometries_are_not_too_many():
    boxes = GeometriesInFrame(geometries=[Geometry(label="b" * 80)] * 1_000)
    move = MoveRequest(world_state=WorldState(obstacles=[boxes]))
    assert decoded(move) == move


@pytest.mark.parametrize(
    "message",
    [
        DoCommandRequest(name="a" * (LARGEST_REST + 1)),
        DoCommandRequest.FromString(b"\x7a\x81\x80\x40" + b"x" * (LARGEST_REST + 1)),
    ],
    ids=["text", "unknown field"],
)
def test_what_is_neither_a_mesh_nor_a_cloud_is_bounded(message):
    with pytest.raises(ConfigError, match=f"over {LARGEST_REST} bytes"):
        decoded(message)


def test_a_struct_of_more_bytes_than_its_values_can_need_is_refused():
    request = DoCommandRequest(name="arm")
    request.command.update({"text": "a" * LARGEST_STRUCT})
    with pytest.raises(ConfigError, match=f"more than the {LARGEST_STRUCT} bytes"):
        decoded(request)


@pytest.mark.parametrize("size", [0, 5, LARGE, LARGE + 1, 5 * LARGE - 3])
async def test_a_message_is_received_whole(size):
    sent = bytes(range(251)) * (size // 251 + 1)
    asked = []

    async def receive(size):
        asked.append(size)
        begin = sum(asked[:-1])
        return sent[begin : begin + size]

    assert bytes(await receive_in_pieces(receive, size)) == sent[:size]
    assert max(asked) <= LARGE


async def test_a_message_that_ends_early_is_received_up_to_there():
    pieces = [b"a" * LARGE, b"b", b""]

    async def receive(size):
        return pieces.pop(0)

    assert len(await receive_in_pieces(receive, 3 * LARGE)) == LARGE + 1


def test_a_large_struct_is_left_as_it_is():
    request = DoCommandRequest(name="arm")
    request.command.update({"text": "a" * LARGE, "values": [1.0] * MOST_FIELDS})
    assert decoded(request) == request


MOVE = around(Geometry(label="part", mesh=Mesh(mesh=CONTENT)), BOX).SerializeToString()


@given(st.integers(0, 200) | st.integers(len(MOVE) - 200, len(MOVE) - 1), st.integers(0, 255))
def test_a_changed_byte_is_garbled_or_read_as_protobuf_reads_it(at, byte):
    data = MOVE[:at] + bytes([byte]) + MOVE[at + 1 :]
    try:
        wanted = MoveRequest.FromString(data)
    except DecodeError:
        wanted = None
    try:
        move = LargeCodec().decode(data, MoveRequest)
    except (DecodeError, ConfigError):
        return
    if wanted is not None:
        for group in move.world_state.obstacles:
            for each in group.geometries:
                if each.HasField("mesh"):
                    each.mesh.mesh = bytes(content_of(each.mesh.mesh))
        assert move == wanted


@given(st.integers(LARGE + 1, len(MOVE) - 1))
def test_a_message_that_is_cut_off_is_garbled(length):
    with pytest.raises(DecodeError):
        LargeCodec().decode(MOVE[:length], MoveRequest)
