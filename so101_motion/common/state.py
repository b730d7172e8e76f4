"""The joint names, a driver's reading of the joints, and the immutable snapshot of the arm's state.

The I/O thread replaces the snapshot whole; readers take the reference and never wait for the bus.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from so101_motion.common.errors import ServoAlarm, in_series
from so101_motion.common.geometry import Array, Brief, freeze
from so101_motion.common.modes import Mode
from so101_motion.common.public import Public
from so101_motion.common.units import angles_deg

ARM_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
"""The five joints of the arm, in the order of every ``q``."""

GRIPPER_JOINT = "gripper"
"""The jaw. It is not a sixth entry of ``q``: an arm has five joints and a gripper."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class JointReading(Brief):
    """The measurements of a driver in one cycle.

    Attributes:
        q: Arm joint angles, shape (5,), [rad].
        qd: Arm joint velocities, shape (5,), [rad/s].
        q_jaw: Jaw angle [rad].
        qd_jaw: Jaw velocity [rad/s].
        alarms: What is wrong with a joint and what to do about it, by joint name. An alarm ends the
            motion of its joint.
        let_go: Joints whose servos have switched themselves off, because they are too hot or take
            too much current. They sink, and move nowhere until the servo holds again by itself.
        driven: Joints whose torque is on; None if the driver does not tell, because it is as the
            mode says.
        out_of_range: Joints outside their limits, by name, with the angle [rad] at which each comes
            back inside. Such a joint gets no goal; when it is moved, it first comes in slowly.
        unanswered: Joints that did not answer this time, or with an impossible value; their angles
            are the last known.
        silent: Joints whose servos have not answered for a while, or were never there.
        unconfirmed: Joints whose angle comes from one reply that no second one has confirmed yet.
        in_play: Joints that may stand still while their motor crosses the play of its gears, by
            name, with how far they fall behind then [rad]. Joints whose load keeps their gears on
            one side are left out.
    """

    q: Array
    qd: Array
    q_jaw: float
    qd_jaw: float
    alarms: Mapping[str, str] = field(default_factory=dict)
    let_go: frozenset[str] = frozenset()
    driven: frozenset[str] | None = None
    out_of_range: Mapping[str, float] = field(default_factory=dict)
    unanswered: frozenset[str] = frozenset()
    silent: frozenset[str] = frozenset()
    unconfirmed: frozenset[str] = frozenset()
    in_play: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self, q=(5,), qd=(5,))

    def let_go_of(self, joints: Sequence[str]) -> str | None:
        """The first of ``joints`` whose servo has switched itself off, or None."""
        return next((joint for joint in joints if joint in self.let_go), None)

    def check_held(self, joints: Sequence[str]) -> None:
        """``ServoAlarm`` if the servo of one of ``joints`` has switched itself off."""
        if (joint := self.let_go_of(joints)) is not None:
            reason = self.alarms.get(joint, "its servo has let go; support the arm")
            raise ServoAlarm(joint, reason, recent=())

    @property
    def angles(self) -> dict[str, float]:
        """The measured angle of each joint by name, the jaw's as well [rad]."""
        arm = zip(ARM_JOINTS, map(float, self.q), strict=True)
        return {**dict(arm), GRIPPER_JOINT: float(self.q_jaw)}


def _is_read_only(q: Array) -> bool:
    return type(q) is np.ndarray and q.shape == (5,) and not q.flags.writeable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class JointState(Public):
    """State of the arm at one instant, measured and commanded.

    Attributes:
        t: Time on the rig's clock [s].
        mode: What the arm is doing.
        reading: Measured angles and velocities.
        q_ref: Joint angles of the trajectory now, shape (5,), [rad].
        qd_ref: Joint velocities of the trajectory now, shape (5,), [rad/s].
        q_jaw_ref: Jaw angle of its trajectory now [rad].
        arm_moving: Whether an arm motion is under way (until settled).
        jaw_moving: Whether a jaw motion is under way (until settled).
        late_ticks: How many setpoints came more than half a period late since the start.
        fault: Why the arm is in FAULT, else None.
        lent_to: What the bus is lent for while the arm is CALIBRATING, else None.
    """

    t: float
    mode: Mode
    reading: JointReading
    q_ref: Array
    qd_ref: Array
    q_jaw_ref: float
    arm_moving: bool
    jaw_moving: bool
    late_ticks: int
    fault: str | None = None
    lent_to: str | None = None

    def __post_init__(self) -> None:
        if not (_is_read_only(self.q_ref) and _is_read_only(self.qd_ref)):  # in no control cycle
            freeze(self, q_ref=(5,), qd_ref=(5,))

    def __repr__(self) -> str:
        return f"<JointState: {self.mode.value}, joints at {angles_deg(self.q)}>"

    @property
    def is_limp(self) -> bool:
        """Whether no joint is held: in LIMP a program that only looks may have found some held."""
        return self.mode is Mode.LIMP and not self.reading.driven

    @property
    def torque(self) -> str:
        """What the joints do, to be put behind "the arm", where the mode alone would be wrong."""
        driven, silent = self.reading.driven, self.reading.silent
        if driven is None or self.mode not in (Mode.LIMP, Mode.HOLDING):
            return ""
        joints = [joint for joint in (*ARM_JOINTS, GRIPPER_JOINT) if joint not in silent]
        held = [joint for joint in joints if joint in driven]
        limp = [joint for joint in joints if joint not in driven]
        if not (limp if self.mode is Mode.HOLDING else held):
            return ""
        if not limp:
            return "holds, as it was found"
        if len(held) < len(limp):
            return f"is limp, but {in_series(held)} {'holds' if len(held) == 1 else 'hold'}"
        return f"holds, but {in_series(limp)} {'is' if len(limp) == 1 else 'are'} limp"

    @property
    def q(self) -> Array:
        """Measured arm joint angles, shape (5,), [rad]."""
        return self.reading.q

    @property
    def qd(self) -> Array:
        """Measured arm joint velocities, shape (5,), [rad/s]."""
        return self.reading.qd

    @property
    def q_jaw(self) -> float:
        """Measured jaw angle [rad]."""
        return self.reading.q_jaw


ANSWERS_AGAIN = "servos did not answer for a while, but all answer again"
"""The fault of an arm whose servos answer again; it is held again only when somebody asks."""


def in_fault(fault: str | None) -> str:
    """The message that an arm in a fault moves nothing before it is told to hold again."""
    told = (fault or "").rstrip(".")
    clear = "" if fault == ANSWERS_AGAIN else "clear it, then "
    then = f"{clear}let the arm hold again (arm.set_torque(True), or Hold on the page)"
    return f"the arm is in a fault: {told}; {then}"


def lent_out(purpose: str) -> str:
    """The message that nothing can be moved while the bus is lent for ``purpose``."""
    return f"the servos are in use for {purpose}; finish or abort that first"
