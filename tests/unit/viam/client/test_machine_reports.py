"""The state of a machine as a snapshot, commands, connecting, and pictures of its camera."""

import asyncio
import math
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.fake_camera import FakeCamera
from harness.in_process_module import client_of
from harness.web_camera import jpeg
from viam.media.video import CameraMimeType, NamedImage
from viam.proto.common import ResponseMetadata
from viam.proto.component.arm import JointPositions

from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.viam.client import rig as client_rig
from so101_motion.viam.client.link import Access
from so101_motion.viam.client.machine import picture_of
from so101_motion.viam.client.reports import (
    AT_REST,
    GripperReport,
    ask_arm,
    ask_gripper,
    next_state,
)
from so101_motion.viam.client.rig import MachineRig

JAW = GripperReport(aperture=0.5)


class Machine:
    """An arm and a gripper that tell what they are given; what is not given they do not know."""

    def __init__(self, *, status=None, joints=None, moves=False, position=None):
        self.status, self.joints, self.moves, self.position = status, joints, moves, position

    async def get_status(self):
        return self._known(self.status)

    async def get_joint_positions(self):
        return JointPositions(values=self._known(self.joints))

    async def is_moving(self):
        return self.moves

    async def do_command(self, command):
        assert command == {"command": "get_position"}
        return self._known(self.position)

    @staticmethod
    def _known(value):
        if value is None:
            raise GRPCError(Status.UNIMPLEMENTED, "not here")
        return value


def told(*, q_deg=(0.0,) * 5, **status):
    status = {"state": "holding", "is_moving": False, **status}
    status["joint_positions_deg"] = dict(zip(ARM_JOINTS, q_deg, strict=True))
    return asyncio.run(ask_arm(Machine(status=status)))


def test_our_module_tells_everything_in_one_answer():
    state = next_state(
        None,
        told(q_deg=(10, 20, 30, 40, 50), state="fault", fault="no power", late_ticks=3.0,
             alarms={"elbow_flex": "hot"}, lent_to="calibration"),
        JAW,
        1.0,
    )  # fmt: skip
    np.testing.assert_allclose(state.q, np.radians([10, 20, 30, 40, 50]))
    assert (state.mode, state.fault, state.late_ticks) == (Mode.FAULT, "no power", 3)
    assert state.reading.alarms == {"elbow_flex": "hot"}
    assert state.lent_to == "calibration"


def test_joints_outside_their_range_are_told_with_their_limits():
    out = {"wrist_roll": {"at_deg": 170.0, "limit_deg": 165.0},
           "gripper": {"at_deg": 110.0, "limit_deg": 100.0}}  # fmt: skip
    state = next_state(None, told(q_deg=(0, 0, 0, 0, 170), out_of_range=out), JAW, 1.0)
    limits = {"wrist_roll": to_rad(165.0), "gripper": to_rad(100.0)}
    assert state.reading.out_of_range == pytest.approx(limits)
    assert state.q_jaw == pytest.approx(to_rad(110.0))  # no aperture says this
    assert (state.q_ref[4], state.q_jaw_ref) == (limits["wrist_roll"], limits["gripper"])
    for nonsense in (None, "all", {"elbow_flex": {}}, {"elbow_flex": {"at_deg": math.nan,
                     "limit_deg": 1.0}}):  # fmt: skip
        state = next_state(None, told(out_of_range=nonsense), JAW, 1.0)
        assert state.reading.out_of_range == {}


@pytest.mark.parametrize(
    ("status", "moves", "mode"),
    [
        (None, False, Mode.HOLDING),
        (None, True, Mode.MOVING),
        ({"mode": "manual"}, False, Mode.GUIDING),
        ({"mode": "auto"}, True, Mode.MOVING),
        ({}, False, Mode.HOLDING),
    ],
)
def test_another_module_is_asked_for_its_joints_and_whether_it_moves(status, moves, mode):
    found = asyncio.run(ask_arm(Machine(status=status, joints=[1, 2, 3, 4, 5], moves=moves)))
    state = next_state(None, found, JAW, 0.0)
    np.testing.assert_allclose(state.q, np.radians([1, 2, 3, 4, 5]))
    assert (state.mode, state.arm_moving) == (mode, moves)


@pytest.mark.parametrize("value", ["north", "1e999", float("nan"), [1.0], None])
def test_an_arm_that_says_no_angle_or_has_other_joints_is_refused(value):
    with pytest.raises(So101Error, match="shoulder_pan"):
        told(q_deg=(value, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(So101Error, match="5 joints"):
        asyncio.run(ask_arm(Machine(joints=[1, 2, 3, 4, 5, 6])))


def test_a_gripper_that_tells_nothing_is_taken_for_closed():
    assert asyncio.run(ask_gripper(Machine())) == GripperReport()
    assert asyncio.run(ask_gripper(None)) == GripperReport()
    found = asyncio.run(ask_gripper(Machine(position={"position_percentage": 40.0}, moves=True)))
    assert found == GripperReport(aperture=pytest.approx(0.4), is_moving=True)
    assert asyncio.run(ask_gripper(Machine(), found)) == GripperReport(aperture=found.aperture)
    health = {
        "gripper": {"silent": True, "faults": ["overload"]},
        "wrist_roll": {"silent": False, "faults": ["overheated"]},
        "elbow_flex": None,
        "wrist_flex": {"faults": 3},
    }
    reading = next_state(None, told(health=health), JAW, 1.0).reading
    assert (reading.silent, reading.let_go) == ({"gripper"}, {"wrist_roll"})


def test_a_resting_joint_that_trembles_is_wanted_where_it_was_or_where_it_came_to_rest():
    first = next_state(None, told(), JAW, 0.0)
    near = next_state(first, told(q_deg=(0.5, 0, 0, 0, 0)), JAW, 0.1)
    np.testing.assert_array_equal(near.q_ref, first.q_ref)
    far = next_state(near, told(q_deg=(np.degrees(AT_REST) + 0.1, 0, 0, 0, 0)), JAW, 0.2)
    np.testing.assert_array_equal(far.q_ref, far.q)
    moving = next_state(None, told(state="moving", is_moving=True), JAW, 0.0)
    later = next_state(
        moving, told(q_deg=(5, 0, 0, 0, 0), state="moving", is_moving=True), JAW, 0.1
    )
    assert later.qd[0] == pytest.approx(np.radians(50.0))
    rests = next_state(later, told(q_deg=(5.4, 0, 0, 0, 0)), JAW, 0.2)
    np.testing.assert_array_equal(rests.q_ref, rests.q)
    assert not rests.qd.any()


# Getting in


def test_a_key_is_never_sent_over_a_plain_connection_which_is_for_access_without_nor_shown():
    plain = Access(address="10.0.0.7:8080").options().dial_options
    assert (plain.insecure, plain.disable_webrtc, plain.credentials) == (True, True, None)
    key_id = "0b6c8a5e-93a7-4a36-8a7e-0d4f3a2f7b11"
    access = Access(address="arm.local.viam.cloud", api_key_id=key_id, api_key="hunter2")
    options = access.options().dial_options
    assert not options.insecure
    assert not options.allow_insecure_with_creds_downgrade
    assert options.credentials.payload == "hunter2"
    assert "hunter2" not in repr(access)
    with pytest.raises(ConfigError, match="host:port"):
        Access(address=" ")


class Changing(FakeCamera):
    """Sends a raw picture and a JPEG that differs from the one before."""

    kinds = (CameraMimeType.VIAM_RGBA, CameraMimeType.JPEG)

    async def get_images(self, **kwargs):
        self.looks += 1
        images = [NamedImage("", jpeg(self.looks), kind) for kind in self.kinds]
        return images, ResponseMetadata()


async def test_a_picture_is_a_jpeg_and_the_next_one_another():
    camera = Changing("top", None)
    async with client_of(camera) as client:
        assert [await picture_of(client) for _ in range(2)] == [jpeg(1), jpeg(2)]
        camera.kinds = (CameraMimeType.VIAM_RGBA,)
        with pytest.raises(ConfigError, match="neither JPEG nor PNG"):
            await picture_of(client)


async def test_an_answer_about_the_caps_that_is_lost_does_not_end_the_look_around(monkeypatch):
    """A plan would be made for ever around what stood there then."""
    monkeypatch.setattr(client_rig, "_LOOKED_AROUND", 0.0)
    asked = []

    async def do_command(command, **_):
        asked.append(command)
        if "get_motion_params" in command:
            raise TimeoutError
        if len(asked) > 4:
            raise ValueError("enough")
        return {}

    caps, made = SimpleNamespace(speed=1.0, acceleration=1.0, take_caps=None), asyncio.Event()
    made.set()
    rig = SimpleNamespace(_setup={"scene": {}}, _looked=threading.Event(), _made=made, arm=caps)
    with pytest.raises(ValueError, match="enough"):
        await MachineRig._look_around(rig, SimpleNamespace(do_command=do_command))
