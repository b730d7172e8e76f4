"""The attributes of all models, for ``component_config``, ``migration`` and the documentation.

A test compares the tables of ``docs/`` with it. The rows of teleoperation are in
``tasks/teleop/config.py``, because the command line uses them too.
"""

from __future__ import annotations

from dataclasses import replace

from so101_motion.calib.record.zero import CONVENTIONS
from so101_motion.common.attributes import (
    ACCELERATION_RANGE_DEG,
    HEAVIEST,
    SPEED_RANGE_DEG,
    Attribute,
)
from so101_motion.drivers.bus.defaults import BAUDRATE, GRIPPER_ID

CALIBRATION_FILE = "so101_calibration.json"
"""Where a calibration is saved by default; the published module's default."""

_RATES = (50.0, 200.0)  # setpoints a second; 200 leave the bus a third of its time; chosen

_SPEED = Attribute(
    "speed_degs_per_sec", "cap of every joint", unit="deg/s", range=SPEED_RANGE_DEG, default=90.0
)
_ACCELERATION = Attribute(
    "acceleration_degs_per_sec_per_sec", "cap of every joint", unit="deg/s^2",
    range=ACCELERATION_RANGE_DEG, default=100.0,
)  # fmt: skip
_MAX_SPEED = Attribute(
    "max_speed_degs_per_sec",
    "what no request exceeds: `MoveOptions`, `set_speed` and teleoperation included",
    unit="deg/s", range=SPEED_RANGE_DEG, default=SPEED_RANGE_DEG[1], ours=True,
)  # fmt: skip
_MAX_ACCELERATION = Attribute(
    "max_acceleration_degs_per_sec_per_sec",
    "what no request exceeds; braking may be harder",
    unit="deg/s^2", range=ACCELERATION_RANGE_DEG, default=ACCELERATION_RANGE_DEG[1], ours=True,
)  # fmt: skip
_PORT_NAME = Attribute(
    "port", "serial port, however spelled; arm, gripper and sensor on it share one connection",
    kind="text", form="path", otherwise="required",
)  # fmt: skip
_FILE = Attribute(
    "calibration_file",
    "relative ones lie in `$VIAM_MODULE_DATA`, or where the program was started if that is not set;"
    " without a file, what the servos have stored counts",
    kind="text", form="path",
)  # fmt: skip
_TIMEOUT = Attribute(
    "timeout",
    "checked; the module asks silent servos until they answer, without keeping anybody waiting;"
    " a number from 100000 up is nanoseconds, as the published module had it",
    kind="own", form='`"5s"`, `"500ms"`, seconds', otherwise="1s",
    link="hardware.md#what-it-does-and-does-not-do",
)  # fmt: skip
_BUS = (
    Attribute(
        "baudrate", "the same for all on a port", kind="whole", unit="bit/s",
        range=(38_400, 1_000_000), default=BAUDRATE, zero_is_none=True,
    ),
    _TIMEOUT,
    Attribute(
        "control_rate_hz", "setpoints a second; the same for all on a port", unit="Hz",
        range=_RATES, otherwise="100", ours=True,
    ),
)  # fmt: skip
SENSES = (
    Attribute(
        "world_state_store", "a world-state store; what is in it is planned around", kind="text",
        form="name", ours=True, link="planning.md#what-the-machine-has-around-the-arm",
    ),
    Attribute(
        "camera", "a camera with depth; what it sees is planned around", kind="text", form="name",
        ours=True, link="planning.md#what-a-camera-sees",
    ),
    Attribute(
        "vision", "a vision service; the objects it finds in that camera's picture count instead",
        kind="text", form="name", ours=True, link="planning.md#what-a-camera-sees",
    ),
)  # fmt: skip
_SURROUNDINGS = (
    Attribute(
        "motion",
        "a motion service that is given `MoveToPosition` instead; `builtin` is viam-server's own",
        kind="text", form="name", otherwise="planned here",
    ),
    Attribute(
        "floor_z_mm", "height of the table that must not be touched", unit="mm",
        range=(-2000.0, 500.0), default=-2.4, ours=True,
    ),
    Attribute(
        "obstacles", "what always stands around, as in a scene file", kind="objects",
        form="list", ours=True, link="planning.md",
    ),
    Attribute(
        "ignore_components", "components of the machine that are not planned around;"
        ' `["*"]` is all of them', kind="names", form="list of names", ours=True,
        link="planning.md#what-the-machine-has-around-the-arm",
    ),
    *SENSES,
    Attribute(
        "payload_kg", "what the gripper always carries", unit="kg", range=(0.0, HEAVIEST),
        default=0.0, ours=True,
    ),
    Attribute(
        "payload_com_mm", "the centre of mass of that, in the tool frame", kind="numbers",
        unit="mm", range=(-1000.0, 1000.0), count=3, form="mm, three numbers",
        otherwise="the jaw's tip", ours=True,
    ),
    Attribute(
        "servo_voltage", "what the servos are rated for", unit="V", range=(0.0, 100.0),
        default=7.4, form="V: 7.4, 12", ours=True,
    ),
    Attribute(
        "position_tolerance_mm", "largest error that counts as arrived", unit="mm",
        range=(0.0, 1000.0), zero_is_none=True, otherwise="0.1",
    ),
    Attribute(
        "orientation_tolerance_deg", "the same for the tool's direction, when it counts",
        unit="deg", range=(0.0, 180.0), zero_is_none=True, otherwise="1",
    ),
    Attribute(
        "use_urdf", "serve the kinematics as URDF instead of SVA", kind="flag", default=False
    ),
    Attribute("visualize_ee_frame", "draw the tool frame", kind="flag", default=False),
    Attribute(
        "collision_guard", "whether moves that do not wait, and streamed points, keep clear of the"
        " arm itself and what is around", kind="flag", default=True, ours=True,
    ),
    Attribute(
        "mesh_decimation_ratios", "checked, without effect", kind="numbers", range=(0.0, 1.0),
        form="list", idle="the meshes here are light as they are",
    ),
)  # fmt: skip
_LOOKS = (
    Attribute(
        "gripper_type", "moving jaw, or handle and trigger", kind="choice",
        options=("follower", "leader"),
    ),
    Attribute(
        "mesh_detail", "how it looks in the 3D view", kind="choice", options=("low", "high")
    ),
)  # fmt: skip

ARM = (
    _PORT_NAME,
    _FILE,
    Attribute(
        "servo_ids", "base to wrist", kind="own", form="five different, 1 to 5",
        otherwise="[1, 2, 3, 4, 5]",
    ),
    Attribute(
        "joint_zero_offsets_deg", "the model's angles in the middle of the joints' travels",
        kind="own", form="deg, by joint or five", otherwise="as the calibration says", ours=True,
        link="hardware.md#where-zero-is",
    ),
    Attribute(
        "joint_zero", "where zero is if neither that nor the calibration says more: the middle of"
        " the travel, or the pose of `set_homing`", kind="choice", options=CONVENTIONS,
        ours=True, link="hardware.md#where-zero-is",
    ),
    replace(_SPEED, default=50.0, zero_is_none=True),
    replace(_ACCELERATION, zero_is_none=True),
    _MAX_SPEED,
    _MAX_ACCELERATION,
    *_BUS,
    Attribute(
        "at_end", "when the module ends: holding, or limp, the arm then sinks under its weight",
        kind="choice", options=("hold", "release"), ours=True,
        link="hardware.md#when-the-program-ends",
    ),
    *_SURROUNDINGS,
    Attribute(
        "waypoint_lookahead_deg", "checked, without effect", unit="deg", range=(0.1, 45.0),
        idle="waypoints are on a planned path here, which is followed at every instant",
    ),
    Attribute(
        "disable_servo_gains", "checked, without effect", kind="flag",
        idle="the servos' gains are never changed; the driver reads them and reckons with them",
    ),
    Attribute(
        "manual_mode",
        "how it yields to a hand: `pos_deadband_deg` (0.5), `p_gain` (8), `torque_limit` (30,"
        " thousandths of full drive), `wall_torque_limit` (300) with which it holds a hand off"
        " contact; `loop_hz` has no effect",
        kind="own", form="object", link="teleoperation.md#hand-guiding",
    ),
)  # fmt: skip
GRIPPER = (
    replace(_PORT_NAME, use="a port of its own", otherwise="this or `arm` is required"),
    Attribute(
        "arm", "the arm it belongs to", kind="text", form="name",
        otherwise="this or `port` is required",
    ),
    Attribute(
        "servo_id", "of the jaw", kind="whole", range=(1, 6), default=GRIPPER_ID, zero_is_none=True
    ),
    *_LOOKS,
    Attribute(
        "articulated_jaw", "true is refused: no planner moves the jaw here", kind="flag",
        default=False, link="migrating.md#what-is-refused-by-name",
    ),
    _FILE,
    *_BUS,
)  # fmt: skip
SIMULATED_ARM = (
    replace(
        _SPEED, use="cap of every joint; another positive number becomes the nearest of these",
        zero_is_none=True, takes_nearest=True,
    ),
    replace(_ACCELERATION, zero_is_none=True, ours=True),
    _MAX_SPEED,
    _MAX_ACCELERATION,
    Attribute(
        "simulate_time", "false: time moves only by `advance_time`", kind="flag", default=True
    ),
    *_SURROUNDINGS,
)  # fmt: skip
SIMULATED_GRIPPER = _LOOKS
CALIBRATION = (
    replace(_PORT_NAME, use="the arm's; shared with the arm and the gripper on it"),
    replace(
        _FILE, use="where a calibration is saved; relative ones lie in `$VIAM_MODULE_DATA`",
        otherwise=f"the arm's, or `{CALIBRATION_FILE}`",
    ),
    Attribute(
        "servo_ids", "only these joints are calibrated; what is known of the others stays",
        kind="own", form="different, 1 to 6", otherwise="all",
    ),
    *(
        replace(
            each, use="checked, without effect", otherwise="none", link="",
            idle="a calibration waits for servos as long as it takes",
        ) if each is _TIMEOUT else each
        for each in _BUS
    ),
)  # fmt: skip
DISCOVERY = (
    Attribute(
        "ports",
        "further ports to look at, which no search finds: a Raspberry Pi's own port, a link",
        kind="own", form="list of paths", otherwise="only what is found", ours=True,
    ),
)  # fmt: skip
FOR_AN_ARM = (
    Attribute("arm", "which arm it serves", kind="text", form="name", otherwise="the only one"),
)
MOTION = (*FOR_AN_ARM, *SENSES)
