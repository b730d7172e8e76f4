"""Hostile requests do not block the event loop, which answers Stop."""

import asyncio
import gc
import gzip
import struct as struct_module
import time

import pytest
from google.protobuf.struct_pb2 import Struct
from grpclib import GRPCError, Status
from harness.in_process_module import guarded_arm, refused
from viam.components.arm import JointPositions, Pose
from viam.gen.component.arm.v1.arm_grpc import ArmServiceStub
from viam.proto.common import DoCommandRequest
from viam.proto.component.arm import GetJointPositionsRequest

from so101_motion.viam.requests.request_guard import DEEPEST, LARGEST, LARGEST_STRUCT, MOST_VALUES

LONGEST_GAP = 0.5
"""Of the processor [s]; what is sent here held the loop for 0.7 to 25 s."""


class Gaps:
    """The longest time of the processor between two turns of the loop."""

    async def __aenter__(self):
        self.longest = 0.0
        self._task = asyncio.create_task(self._tick())
        await asyncio.sleep(0)
        return self

    async def __aexit__(self, *error):
        self._task.cancel()
        await asyncio.wait([self._task])

    async def _tick(self):
        before = time.thread_time()
        while True:
            await asyncio.sleep(0.001)
            now = time.thread_time()
            self.longest, before = max(self.longest, now - before), now


async def test_requests_leave_nothing_to_the_garbage_collector():
    """It stops the control loop for as long as it takes."""
    async with guarded_arm() as arm:
        gc.collect()
        gc.disable()
        try:
            for _ in range(50):
                await arm.get_joint_positions()
            assert gc.collect() < 5 * 50  # four a request are the SDK's; there were 33
        finally:
            gc.enable()


async def refusal(call):
    """The error that a call ends with, seen while the loop goes on."""
    async with Gaps() as gaps:
        with pytest.raises(GRPCError) as caught:
            await call
    assert gaps.longest < LONGEST_GAP
    return caught.value


LONG = {"not ascii": "é" * 100_000, "ascii": "a" * 300_000, "escapes": "\\\n\x00" * 30_000}


@pytest.mark.parametrize("text", LONG.values(), ids=LONG)
async def test_a_long_text_is_refused_at_once_and_not_echoed(text):
    at, zeros = Pose(x=200, z=200, o_z=1), [0.0] * 5
    async with guarded_arm() as arm:
        for call in (
            arm.do_command({"command": text}),
            arm.do_command({text: 1.0}),
            arm.do_command({"set_speed": text}),
            arm.do_command({"command": "advance_time", "seconds": text}),
            arm.do_command({"command": "advance_time", text: 1.0}),
            arm.do_command({"command": [text, {text: text}]}),
            arm.move_to_position(at, extra={"goal_metric_type": text}),
            arm.move_to_position(at, extra={"pose_cloud": {text: 1.0}}),
            arm.move_to_joint_positions(JointPositions(values=zeros), extra={"wait": text}),
            arm.move_to_joint_positions(JointPositions(values=[1e9] * 100_000)),
        ):
            error = await refusal(call)
            assert error.status is Status.INVALID_ARGUMENT
            assert len(error.message) <= 1_000


async def test_a_component_of_a_long_name_is_not_found_at_once():
    async with guarded_arm() as arm:
        arm.name = "é" * 100_000
        error = await refusal(arm.do_command({"command": "advance_time"}))
        assert error.status is Status.NOT_FOUND
        assert len(error.message) <= 1_000


async def test_a_thousand_unknown_options_are_not_all_compared_with_ours():
    options = {f"option number {i} of many that nobody knows": 1.0 for i in range(1_000)}
    options["goal_metric_type"] = "none"
    async with guarded_arm() as arm:
        await refusal(arm.move_to_position(Pose(x=200, z=200, o_z=1), extra=options))


def struct_of(value):
    struct = Struct()
    struct.update(value)
    return struct


async def test_a_struct_of_too_many_values_or_bytes_is_refused_with_the_limit():
    many = struct_of({"command": "x", "v": [0.0] * (MOST_VALUES + 1)})
    large = struct_of({"command": "x" * (LARGEST_STRUCT + 1)})
    async with guarded_arm() as arm:
        stub = ArmServiceStub(arm.channel)
        for struct, limit in ((many, f"{MOST_VALUES} values"), (large, f"{LARGEST_STRUCT}")):
            error = await refusal(stub.DoCommand(DoCommandRequest(name="arm", command=struct)))
            assert error.status is Status.INVALID_ARGUMENT
            assert limit in error.message


async def test_a_message_that_is_too_large_is_refused_before_it_is_decoded():
    async with guarded_arm() as arm:
        request = DoCommandRequest(name="a" * (LARGEST + 1))
        error = await refusal(ArmServiceStub(arm.channel).DoCommand(request))
    assert error.status is Status.INVALID_ARGUMENT
    assert f"{LARGEST} bytes" in error.message


def nested(levels):
    value = {"a": 1.0}
    for _ in range(levels):
        value = {"a": value}
    request = DoCommandRequest(name="arm")
    request.command.update(value)
    return request


async def test_structs_nested_too_deeply_are_an_invalid_argument():
    async with guarded_arm() as arm:
        stub = ArmServiceStub(arm.channel)
        for levels in (DEEPEST + 1, 60, 90):
            error = await refusal(stub.DoCommand(nested(levels)))
            assert error.status is Status.INVALID_ARGUMENT
            assert "nested" in error.message


async def test_a_compressed_request_is_refused_with_a_sentence():
    message = gzip.compress(GetJointPositionsRequest(name="arm").SerializeToString())
    async with guarded_arm() as arm:

        async def ask():
            async with ArmServiceStub(arm.channel).GetJointPositions.open() as stream:
                await stream.send_request()
                head = struct_module.pack(">?I", True, len(message))
                await stream._stream.send_data(head + message, end_stream=True)
                await stream.recv_message()

        await refused(ask(), Status.UNIMPLEMENTED, "switch compression off")
