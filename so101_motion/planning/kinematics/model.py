"""The kinematic model of the arm: frames, Jacobians, torques and joint limits.

It wraps Pinocchio, which is imported here and in ``collision`` only. All results are arrays or our
own :class:`~so101_motion.common.geometry.SE3`.

There are two Pinocchio models inside. ``pin_model`` has all six joints, in the order of
``ARM_JOINTS`` and then the jaw; pictures and collision checks need the jaw. For kinematics the jaw
is locked, so that a configuration has five numbers as everywhere else in the package.

Pinocchio writes its results into a ``Data`` object, so a model belongs to one thread; load another
for another thread (it takes milliseconds). Its ``lowerVelocityLimit`` is positive for a URDF
(observed in pin 4.1.0); it is not used here.
"""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import so101_description
from numpy.typing import ArrayLike

from so101_motion.common.attributes import suggest
from so101_motion.common.errors import ConfigError, OutsideLimits
from so101_motion.common.geometry import SE3, Array, frozen_array, given_array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import range_deg, to_deg

LINKS = tuple(so101_description.PARTS)  # by their names in the URDF, from the base outwards
JAW_LINK = LINKS[-1]  # placed by the jaw's joint too
GRIPPER_LINK = "gripper_link"  # the tool, the jaw tip and held objects are fixed to it

_OUR_FRAMES = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)


ROUNDED = math.radians(0.01)  # a goal so little outside its limits is drawn in [rad]


class RobotModel:
    """The SO-101's kinematics, read from a URDF. Belongs to one thread.

    Attributes:
        pin_model: The Pinocchio model with all six joints, for ``collision.py``.
        lower: Smallest joint angles, shape (5,), [rad].
        upper: Largest joint angles, shape (5,), [rad].
        limits: The same as five pairs of plain numbers, lower and upper, for inner loops.
        gripper_frames: Names of the frames fixed to the gripper; goals may name one of these.
    """

    def __init__(
        self,
        pin_model: Any,
        frames: dict[str, tuple[str, SE3]] | None = None,
        *,
        bounds: str = "limits",
    ) -> None:
        self.pin_model = pin_model
        self._bounds = bounds  # what messages call the joint limits
        self._extra = dict(frames or {})
        self._full_data = pin_model.createData()
        jaw = [pin_model.getJointId(GRIPPER_JOINT)]
        self._arm = pin.buildReducedModel(pin_model, jaw, np.zeros(pin_model.nq))
        for name, (parent, T_parent_frame) in self._extra.items():
            _add_frame(self._arm, name, parent, T_parent_frame)
        self._data = self._arm.createData()
        self.lower = frozen_array(self._arm.lowerPositionLimit, (5,))
        self.upper = frozen_array(self._arm.upperPositionLimit, (5,))
        self.limits = tuple(zip(self.lower.tolist(), self.upper.tolist(), strict=True))
        self._ids = {
            frame.name: i
            for i, frame in enumerate(self._arm.frames)
            if frame.type in _OUR_FRAMES and frame.name not in ("universe", JAW_LINK)
        }
        # References into Data: forward kinematics refreshes them in place, and looking one up
        # by index costs as much as the kinematics of the whole arm.
        self._placements = {name: self._data.oMf[i] for name, i in self._ids.items()}
        self._link_placements = {
            name: self._full_data.oMf[pin_model.getFrameId(name)] for name in LINKS
        }
        gripper = self._arm.frames[self._ids[GRIPPER_LINK]].parentJoint
        self.gripper_frames = tuple(
            name for name, i in self._ids.items() if self._arm.frames[i].parentJoint == gripper
        )
        T_gripper_tool = self._arm.frames[self._ids["tool"]].placement
        self._rotations_to_tool: dict[str, Array] = {
            name: self._arm.frames[self._ids[name]].placement.actInv(T_gripper_tool).rotation
            for name in self.gripper_frames
        }

    @classmethod
    def load(cls, urdf: Path = so101_description.URDF_PATH) -> RobotModel:
        """Read the arm from a URDF with the joints and frames of ours.

        Args:
            urdf: The file; the package's own if not given.

        Raises:
            ConfigError: The file is no URDF, or lacks one of our joints or frames.
        """
        try:
            model = pin.buildModelFromUrdf(str(urdf))
        except (ValueError, RuntimeError) as error:
            raise ConfigError("urdf", str(urdf), f"cannot be read: {error}") from error
        joints = tuple(model.names)[1:]
        if joints != (*ARM_JOINTS, GRIPPER_JOINT):
            wanted = ", ".join((*ARM_JOINTS, GRIPPER_JOINT))
            raise ConfigError("urdf", str(urdf), f"must have exactly the joints {wanted}")
        for name in (*LINKS, "tool"):
            if not model.existFrame(name):
                raise ConfigError("urdf", str(urdf), f'has no link "{name}"')
        return cls(model)

    def with_frame(self, name: str, T_tool_frame: SE3) -> RobotModel:
        """This model with one more frame fixed to the gripper: a held object, a pen, a camera.

        Args:
            name: Name of the frame, also in goals.
            T_tool_frame: Its pose in the tool frame.

        Raises:
            ConfigError: There is a frame of that name already.
        """
        if name in self._ids:
            raise ConfigError("frame", name, "is the name of another frame; choose a new one")
        frames = {**self._extra, name: ("tool", T_tool_frame)}
        return RobotModel(self.pin_model, frames, bounds=self._bounds)

    def with_payload(self, mass: float, p_tool: ArrayLike) -> RobotModel:
        """This model with a mass [kg] fixed to the gripper at ``p_tool`` [m]; for torques."""
        loaded = pin.Model(self.pin_model)
        tool = loaded.frames[loaded.getFrameId("tool")]
        p_joint = tool.placement.act(np.asarray(p_tool, dtype=np.float64))
        point = pin.Inertia(mass, p_joint, np.zeros((3, 3)))
        loaded.appendBodyToJoint(tool.parentJoint, point, pin.SE3.Identity())
        return RobotModel(loaded, self._extra, bounds=self._bounds)

    def narrowed(self, lower: ArrayLike, upper: ArrayLike) -> RobotModel:
        """This model with its joint limits narrowed to those of one calibrated arm.

        Raises:
            ConfigError: The limits of a joint exclude each other.
        """
        narrow = self.pin_model.copy()
        lower, upper = np.maximum(self.lower, lower), np.minimum(self.upper, upper)
        for i in range(5):
            if not lower[i] < upper[i]:
                raise ConfigError(
                    ARM_JOINTS[i], [to_deg(float(lower[i])), to_deg(float(upper[i]))],
                    "are limits [deg] whose lower one is not below the upper; calibrate again"
                )  # fmt: skip
        narrow.lowerPositionLimit[:5], narrow.upperPositionLimit[:5] = lower, upper
        return RobotModel(narrow, self._extra, bounds="calibrated range")

    def mounted(self, R_world_base: ArrayLike) -> RobotModel:
        """This model with its base turned, shape (3, 3), z of the world being up; for torques."""
        turned = self.pin_model.copy()
        turned.gravity.linear = np.asarray(R_world_base).T @ self.pin_model.gravity.linear
        return RobotModel(turned, self._extra, bounds=self._bounds)

    def frame(self, q: ArrayLike, name: str = "tool") -> SE3:
        """The pose of a frame, ``T_base_<name>``.

        Args:
            name: ``"tool"``, ``"jaw_tip"``, a link such as ``"wrist_link"``, or a frame added by
                :meth:`with_frame`.

        Raises:
            ConfigError: There is no such frame, or ``q`` has another shape.
        """
        joints = given_array("q", q, (5,), "joint angles in radians")
        return SE3(*self.rotation_and_position(joints, name))

    def rotation_and_position(self, q: Array, name: str = "tool") -> tuple[Array, Array]:
        """``R`` (3, 3) and ``p`` (3,) of :meth:`frame`, as views that the next call overwrites."""
        placement = self._placements.get(name)
        if placement is None:
            raise self._no_such(name)
        pin.framesForwardKinematics(self._arm, self._data, q)
        return placement.rotation, placement.translation

    def rotation_to_tool(self, frame: str) -> Array:
        """``R_<frame>_tool`` for a frame fixed to the gripper, shape (3, 3)."""
        return self._rotations_to_tool[frame]

    def on_last_joint(self, name: str) -> Array:
        """Where a frame of the gripper sits on the joint that moves it.

        Rotation by rows, then translation [m], shape (12,).
        """
        placement = self._arm.frames[self._ids[name]].placement
        return np.concatenate((placement.rotation.ravel(), placement.translation))

    def frame_jacobian(self, q: ArrayLike, name: str = "tool") -> Array:
        """The Jacobian of a frame, shape (6, 5), in the axes of the base.

        Three rows of linear velocity of the frame's origin [m/rad], three of angular velocity.

        Raises:
            ConfigError: There is no such frame.
        """
        index = self._ids.get(name)
        if index is None:
            raise self._no_such(name)
        q = np.asarray(q, dtype=np.float64)
        J = pin.computeFrameJacobian(
            self._arm, self._data, q, index, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return np.asarray(J)

    def link_placements(self, q: ArrayLike, q_jaw: float) -> dict[str, SE3]:
        """``T_base_<link>`` of all seven links by name, from the base outwards; for pictures."""
        q_full = np.append(np.asarray(q, dtype=np.float64), q_jaw)
        pin.framesForwardKinematics(self.pin_model, self._full_data, q_full)
        return {name: SE3(T.rotation, T.translation) for name, T in self._link_placements.items()}

    def gravity_torque(self, q_full: ArrayLike) -> Array:
        """Torques of all six joints that hold still at ``q_full`` (6,), shape (6,), [N m]."""
        q_full = np.asarray(q_full, dtype=np.float64)
        return np.array(pin.computeGeneralizedGravity(self.pin_model, self._full_data, q_full))

    def moved_bodies(self) -> tuple[Array, Array]:
        """What each joint moves, shape (6, 16), and gravity in the base, shape (3,), [m/s^2].

        A row is the joint's placement in the one before, rotation by rows and position [m], and
        the mass [kg] and centre [m] of what turns with it. Each joint turns about its z.
        """
        model, rows = self.pin_model, []
        for i in range(1, model.njoints):
            at, body = model.jointPlacements[i], model.inertias[i]
            rows.append([*at.rotation.ravel(), *at.translation, body.mass, *body.lever])
        return np.array(rows), np.array(model.gravity.linear)

    def torques(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torques of the arm joints for a motion, without friction, shape (m, 5), [N m]."""
        found = np.empty_like(q)
        rnea, model, data = pin.rnea, self._arm, self._data
        for k in range(len(q)):
            found[k] = rnea(model, data, q[k], qd[k], qdd[k])
        return found

    def holding_torques(self, q: Array) -> Array:
        """Torques of the arm joints that hold still at ``q`` (m, 5), shape (m, 5), [N m]."""
        found = np.empty_like(q)
        for k, configuration in enumerate(q):
            found[k] = pin.computeGeneralizedGravity(self._arm, self._data, configuration)
        return found

    @cached_property
    def holding_torque_rates(self) -> Array:
        """Bounds on how much each joint's torque changes with each angle, (5, 5), [N m/rad].

        A joint moves the masses that it carries. The masses that load both of two joints are those
        carried by the outer one, so the bound is the weight of each of these times its distance
        from the outer joint. A vertical joint bears no weight and changes no load of others.
        """
        model, moments = self._arm, np.zeros(5)
        for joint in range(1, 6):
            away = 0.0
            for k in range(joint, 6):
                away += float(np.linalg.norm(model.jointPlacements[k].translation)) * (k > joint)
                mass = model.inertias[k]
                moments[joint - 1] += mass.mass * (away + float(np.linalg.norm(mass.lever)))
        outer = np.maximum.outer(np.arange(5), np.arange(5))
        rates = np.asarray(np.linalg.norm(model.gravity.linear) * moments[outer])
        axis = model.jointPlacements[1].rotation[:, 2]
        if np.allclose(np.cross(axis, model.gravity.linear), 0.0):
            rates[0] = rates[:, 0] = 0.0
        return rates

    def check_gripper_frame(self, name: str) -> None:
        """Refuse a frame that is not fixed to the gripper.

        Raises:
            ConfigError: Says which ones are.
        """
        if name not in self.gripper_frames:
            known = suggest(name, self.gripper_frames)
            raise ConfigError("frame", name, f"is not fixed to the gripper; {known}{self._more}")

    def outside(self, q: ArrayLike, tolerance: float = 1e-9) -> int | None:
        """The joint that is furthest outside its limits, as an index into ``q``, or None.

        Args:
            q: Joint angles, shape (5,), [rad]. NaN is outside.
            tolerance: How far beyond a limit still counts as inside [rad].
        """
        q = np.asarray(q, dtype=np.float64)
        excess = np.maximum(self.lower - q, q - self.upper)
        excess = np.where(np.isnan(excess), np.inf, excess)
        worst = int(np.argmax(excess))
        return worst if excess[worst] > tolerance else None

    def within_limits(self, q: ArrayLike) -> Array:
        """Joint angles, drawn in where a rounded number is ``ROUNDED`` beyond a limit, (5,), [rad].

        Raises:
            OutsideLimits: As ``check_limits``.
        """
        self.check_limits(q)
        return np.clip(np.asarray(q, dtype=np.float64), self.lower, self.upper)

    def check_limits(self, q: ArrayLike) -> None:
        """Refuse joint angles outside the limits by more than ``ROUNDED``.

        Raises:
            OutsideLimits: Names the joint that is furthest outside, its value and its limits.
        """
        i = self.outside(q, ROUNDED)
        if i is None:
            return
        value = float(np.asarray(q, dtype=np.float64)[i])
        lower, upper = float(self.lower[i]), float(self.upper[i])
        raise OutsideLimits(
            f"{ARM_JOINTS[i]} = {to_deg(value):.2f} deg is outside its {self._bounds} "
            f"{range_deg(lower, upper)} deg; choose a value between them",
            joint=ARM_JOINTS[i],
            value=value,
            lower=lower,
            upper=upper,
        )

    def _no_such(self, name: str) -> ConfigError:
        known = f"known: {', '.join(self._ids)}{self._more}"
        return ConfigError("frame", name, f"is not a frame of this arm; {known}")

    @property
    def _more(self) -> str:
        """Where frames come from that an arm without a tool does not have."""
        how = "Arm.set_tool, or --tool in a terminal"
        return "" if self._extra else f'. "tcp" and others come with a tool: {how}'


def _add_frame(model: Any, name: str, parent: str, T_parent_frame: SE3) -> None:
    base = model.frames[model.getFrameId(parent)]
    offset = pin.SE3(np.array(T_parent_frame.R), np.array(T_parent_frame.p))
    model.addFrame(pin.Frame(name, base.parentJoint, base.placement * offset, pin.OP_FRAME))
