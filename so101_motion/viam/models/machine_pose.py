"""Answer the machine's ``GetPose`` on this module's own socket.

viam-server does not pass ``GetPose`` of a motion service on to the module. Its client sends the
machine's request of that name to the module's socket instead, and the SDK answers UNIMPLEMENTED.
Here the request is passed on to the machine, which knows all frames. It does not name the service,
so all motion services of this module give the same answer.
"""

from __future__ import annotations

from grpclib import GRPCError, Status
from grpclib.server import Stream
from viam.proto.robot import GetPoseRequest, GetPoseResponse
from viam.robot.service import RobotService

from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.conversion.frames import GIVE_FRAME, asked, machine_here


async def _get_pose(service: RobotService, stream: Stream[GetPoseRequest, GetPoseResponse]) -> None:
    request = await stream.recv_message()
    assert request is not None
    machine = machine_here()
    if machine is None:
        raise GRPCError(
            Status.FAILED_PRECONDITION,
            "the module is not connected to its machine, which knows where its components are;"
            " try again when viam-server is up",
        )
    transforms = list(request.supplemental_transforms)
    with grpc_statuses():
        try:
            pose = await asked(
                lambda: machine.get_pose(
                    request.component_name, request.destination_frame, transforms
                )
            )
        except GRPCError as error:  # viam-server's have the status UNKNOWN
            if "not in frame system" not in (error.message or ""):
                raise
            raise GRPCError(Status.NOT_FOUND, f"{error.message}; {GIVE_FRAME}") from error
    await stream.send_message(GetPoseResponse(pose=pose))


def serve_get_pose() -> None:
    """Answer ``GetPose`` on all servers that are made from now on."""
    setattr(RobotService, "GetPose", _get_pose)  # noqa: B010  # the SDK has no hook for it
