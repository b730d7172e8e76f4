"""Every reader of outside input: the inputs it is given, and the errors it may raise."""

import asyncio
import io
import itertools
import json
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from google.protobuf import json_format
from google.protobuf.message import DecodeError
from google.protobuf.struct_pb2 import Struct
from viam.components.arm import JointPositions
from viam.proto.common import GeometriesInFrame, Geometry, Pose, WorldState
from viam.proto.common import Mesh as ViamMesh
from viam.proto.common import PointCloud as ViamCloud

from so101_motion.calib.motors import setup_view
from so101_motion.calib.procedure import journal
from so101_motion.calib.record import record, store, zero
from so101_motion.calib.record.record import JOINTS
from so101_motion.common.errors import So101Error
from so101_motion.common.geometry import SE3
from so101_motion.drivers.bus.protocol import Answers
from so101_motion.drivers.emulator.codec import Listener, frame
from so101_motion.drivers.emulator.faults import parse_fault
from so101_motion.drivers.emulator.hand import parse_script
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.files.scene_file import read_scene
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.collision.shape_files import file_mesh, read_cloud, read_shape
from so101_motion.tasks.guided import GuidedPath
from so101_motion.tasks.guided import files as guided_files
from so101_motion.tasks.program import files as program_files
from so101_motion.tasks.teleop.config import TeleopConfig
from so101_motion.viam.client import reports
from so101_motion.viam.component_config import (
    CalibrationConfig,
    HardwareArmConfig,
    HardwareGripperConfig,
    SimulatedArmConfig,
    SimulatedGripperConfig,
)
from so101_motion.viam.conversion.frames import Frames
from so101_motion.viam.conversion.geometries import from_geometry
from so101_motion.viam.conversion.world_state import scene_with
from so101_motion.viam.migration import migrate

OURS = (So101Error,)
"""What a reader may raise."""

TRIANGLE = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])


@dataclass(frozen=True)
class Reader:
    """A reader of bytes, which raises one of ``OURS`` or returns, and good inputs."""

    name: str
    read: Callable[[bytes], object]
    seeds: tuple[bytes, ...]


def _json(value):
    return json.dumps(value).encode()


def _calibration(**changes):
    entry = {"id": 1, "drive_mode": 0, "homing_offset": -5, "range_min": 758, "range_max": 3292}
    return {joint: {**entry, "id": i, **changes} for i, joint in enumerate(JOINTS, 1)}


_ZEROS = {"joints": {joint: {"by": "stops", "angle": 0.1} for joint in JOINTS}}
_HELD = {joint: [5, 700, 3000] for joint in JOINTS}
_JOURNAL = {
    "before": _HELD, "meanwhile": _HELD, "is_decided": True,
    "saving": {"calibration": _calibration(), "zeros": {"elbow_flex": ["stops", 0.1]}},
}  # fmt: skip
_SCENE = {
    "floor_z_mm": -2.4, "margin_mm": 3.0,
    "obstacles": [
        {"name": "a", "box_mm": [10, 20, 30], "position_mm": [200, 0, 10], "rpy_deg": [0, 0, 9]},
        {"name": "b", "sphere_radius_mm": 10, "position_mm": [200, 0, 10]},
        {"name": "c", "capsule_radius_mm": 10, "capsule_length_mm": 50},
        {"name": "d", "points_mm": [[1, 2, 3], [4, 5, 6]], "resolution_mm": 5},
        {"name": "e", "vertices_mm": (TRIANGLE * 1e3).tolist(), "triangles": [[0, 1, 2]]},
    ],
    "attached": [{"name": "f", "box_mm": [10, 20, 30]}], "may_touch": [["a", "f"]],
}  # fmt: skip
_PROGRAM = {
    "schema": "so101/program/1", "rounds": 3,
    "waypoints": [
        {"q_deg": [0, 1, 2, 3, 4], "aperture_percent": 50, "pause_s": 1.5, "name": "a"},
        {"q_deg": [0, 1, 2, 3, 40], "pass": True},
    ],
}  # fmt: skip
_POSES = {"schema": "so101/poses/1", "poses": [{"name": "a", "q_deg": [0, 1, 2, 3, 4]}]}
_PROGRESS = {"port": "/dev/ttyACM0", "workflow": "motors", "step": "id", "done": ["gripper"]}
_ATTRIBUTES = (
    {"speed_degs_per_sec": 50, "acceleration_degs_per_sec_per_sec": 100, "simulate_time": True},
    {"port": "/dev/ttyACM0", "servo_ids": [1, 2, 3, 4, 5], "baudrate": 1e6, "timeout": "1s"},
    {"port": "/dev/ttyACM0", "calibration_file": "a.json", "manual_mode": {"p_gain": 8}},
    {"leader_arm": "a", "follower_arm": "b", "rate_hz": 50, "offsets_deg": {"elbow_flex": 3}},
)
_STATUS = {
    "joint_positions_deg": dict.fromkeys((*JOINTS, "gripper"), 1.5), "state": "holding",
    "is_moving": True, "late_ticks": 3, "alarms": {"elbow_flex": "hot"}, "fault": "it fell",
    "lent_to": "calibration", "mode": "manual", "values": [1, 2, 3, 4, 5],
}  # fmt: skip
_CONFIGURATION = {
    "components": [
        {
            "name": "arm", "api": "rdk:component:arm", "model": "devrel:so101:arm",
            "attributes": {"port": "/dev/ttyACM0", "baudrate": 1_000_000, "speed_degs_per_sec": 5},
            "depends_on": ["a"], "frame": {"parent": "world"},
        }
    ],
    "modules": [{"name": "so101", "type": "registry", "module_id": "devrel:so101-arm"}],
    "fragments": ["a"],
}  # fmt: skip
_STL = b"x" * 80 + (1).to_bytes(4, "little") + TRIANGLE.astype("<f4").tobytes() + b"\0\0"
_PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n"
)
_PLY_BINARY = (
    _PLY.partition(b"0 0 0\n")[0].replace(b"ascii", b"binary_little_endian")
    + TRIANGLE.astype("<f4").tobytes()
    + b"\3"
    + np.array([0, 1, 2], "<i4").tobytes()
)
_PCD = (
    b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\nHEIGHT 1\n"
    b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA "
)
_PCD_ASCII = _PCD + b"ascii\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
_PCD_BINARY = _PCD + b"binary\n" + TRIANGLE.astype("<f4").tobytes()
_PCD_PACKED = (  # field by field, 32 bytes and 16 as they are
    _PCD
    + b"binary_compressed\n"
    + np.array([50, 48], "<u4").tobytes()
    + b"\x1f"
    + TRIANGLE.T.astype("<f4").tobytes()[:32]
    + b"\x0f"
    + TRIANGLE.T.astype("<f4").tobytes()[32:]
)
_XYZ = b"# x y z\n0 0 0\n0.1 0 0 255 0 0\n0 0.1 0\n0 0 0.1\n"
_OBJ = b"o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\nv 0 0 1\nf -1 -3 -4\n"
_OFF = b"OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n4 0 1 2 3\n"


def _glb():
    return trimesh.Trimesh(TRIANGLE, [[0, 1, 2], [0, 1, 3]], process=False).export(file_type="glb")


def _3mf():
    model = (
        '<model unit="millimeter"'
        ' xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        '<object id="1" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/>'
        '<vertex x="9" y="0" z="0"/><vertex x="0" y="9" z="0"/></vertices>'
        '<triangles><triangle v1="0" v2="1" v3="2"/></triangles></mesh></object></resources>'
        '<build><item objectid="1"/></build></model>'
    )
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        file.writestr("3D/3dmodel.model", model)
    return out.getvalue()


def _guided_path(folder):
    file = folder / "seed.json"
    q = np.radians([[0, -20, 30, 5, 0], [10, -20, 30, 5, 0]])
    guided_files.write(GuidedPath(t=[0.0, 0.5], q=q, aperture=[0.25, 0.5]), file)
    return file.read_bytes()


def _world(*geometries):
    group = GeometriesInFrame(reference_frame="arm_origin", geometries=geometries)
    return WorldState(obstacles=[group]).SerializeToString()


def _mesh(data):
    return Geometry(label="m", center=Pose(o_z=1.0), mesh=ViamMesh(content_type="ply", mesh=data))


def _cloud(data):
    return Geometry(label="c", center=Pose(o_z=1.0), pointcloud=ViamCloud(point_cloud=data))


def _read_geometry(make):
    def read(data):
        return read_shape(from_geometry(make(data)))

    return read


def _read_world(data):
    try:
        world = WorldState.FromString(data)
    except DecodeError:
        return
    frames = Frames("arm", SE3.identity(), world.transforms)
    asyncio.run(scene_with(Scene(), world, frames))


def _read_attributes(kinds):
    def read(data):
        try:
            attributes = json.loads(data)
        except (ValueError, RecursionError):
            return
        if not isinstance(attributes, dict):
            return
        refused = None
        for kind in kinds:
            try:
                kind.from_attributes(attributes)
            except OURS as error:
                refused = error
        if refused is not None:
            raise refused

    return read


def _read_answers(data):
    whole, cut = Answers((1, 2, 3), 4), Answers((1, 2, 3), 4)
    whole.feed(data)
    for start in range(0, len(data), 3):
        cut.feed(data[start : start + 3])
    assert cut.found == whole.found, f"{cut.found} in pieces, {whole.found} at once"
    Listener().hear(data)


def _read_calibration(path):
    found = store.read(path)
    record.check(found.calibration)  # what is read can be true
    assert set(found.zeros) <= set(found.calibration)


def _read_zeros(path):
    zeros, notes = zero.read_zeros(path, record.parse(_calibration()))
    assert not (zeros and notes)
    assert all(note.isprintable() for note in notes)


class _Machine:
    """An arm of a machine that says whatever it likes."""

    def __init__(self, status):
        self._status = status

    async def get_status(self):
        return self._status

    async def get_joint_positions(self):
        values = self._status.get("values")
        return JointPositions(values=values if isinstance(values, list) else [0.0] * 5)

    async def is_moving(self):
        return False


def _read_machine(data):
    try:
        status = Struct()
        status.update(json.loads(data))
        arm = _Machine(json_format.MessageToDict(status))
        arm.get_joint_positions().close()
        JointPositions(values=arm._status.get("values", ()))
    except (ValueError, TypeError, AttributeError, ArithmeticError, RecursionError):
        return  # what cannot be on the wire
    report = asyncio.run(reports.ask_arm(arm))
    state = reports.next_state(None, report, reports.GripperReport(), 0.0)
    assert np.all(np.isfinite(state.q_ref)), f"the arm is at {state.q_ref}"


def _read_configuration(data):
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        return
    migrate(content).configuration()


def _read_words(data):
    text = data.decode(errors="replace")
    refused = None
    for parse in (parse_fault, parse_script):
        try:
            parse(text)
        except OURS as error:
            refused = error
    if refused is not None:
        raise refused


_KINDS = (
    SimulatedArmConfig, SimulatedGripperConfig, HardwareArmConfig, HardwareGripperConfig,
    CalibrationConfig, TeleopConfig,
)  # fmt: skip


_folder = tempfile.TemporaryDirectory()  # for what they read from files


def _all_readers(folder):
    names = itertools.count()

    def of_file(read, name=None):
        path = folder / (name or f"reader{next(names)}.json")
        path.parent.mkdir(parents=True, exist_ok=True)

        def run(data):
            path.write_bytes(data)
            return read(path)

        return run

    at = folder / "journal" / "arm.json"
    journal_name = journal.path_for(at).relative_to(folder)
    answers = b"".join(frame(i, 0, bytes((1, 2, 3, 255))) for i in (1, 2, 3))
    return (
        Reader("packets", _read_answers, (answers, answers[5:], b"\xff" * 9)),
        Reader("calibration", of_file(_read_calibration), (_json(_calibration()),)),
        Reader("zeros", of_file(_read_zeros), (_json(_ZEROS),)),
        Reader("journal", of_file(lambda _: journal.read(at), journal_name), (_json(_JOURNAL),)),
        Reader(
            "progress",
            of_file(lambda path: setup_view.SetupProgress(path, None)),
            (_json(_PROGRESS),),
        ),
        Reader("scene", of_file(read_scene), (_json(_SCENE),)),
        Reader("program", of_file(program_files.read), (_json(_PROGRAM),)),
        Reader("guided path", of_file(guided_files.read), (_guided_path(folder),)),
        Reader("poses", of_file(lambda path: SavedPoses(path).own()), (_json(_POSES),)),
        Reader("attributes", _read_attributes(_KINDS), tuple(map(_json, _ATTRIBUTES))),
        Reader("world state", _read_world, (_world(_mesh(_PLY), _cloud(_PCD_BINARY)),)),
        Reader("mesh", _read_geometry(_mesh), (_STL, _PLY, _PLY_BINARY)),
        Reader("cloud", _read_geometry(_cloud), (_PCD_ASCII, _PCD_BINARY, _PCD_PACKED)),
        Reader("xyz", partial(read_cloud, "xyz"), (_XYZ,)),
        *(
            Reader(kind, partial(file_mesh, kind), (seed,))
            for kind, seed in (("obj", _OBJ), ("off", _OFF), ("glb", _glb()), ("3mf", _3mf()))
            if kind != "3mf" or (find_spec("networkx") and find_spec("lxml"))  # it needs both
        ),
        Reader("machine", _read_machine, (_json(_STATUS),)),
        Reader("machine configuration", _read_configuration, (_json(_CONFIGURATION),)),
        Reader(
            "faults and hands",
            _read_words,
            (b"hot:3=60@1+5", b"1 elbow_flex start\n2 elbow_flex 9"),
        ),
    )


ALL = _all_readers(Path(_folder.name))
