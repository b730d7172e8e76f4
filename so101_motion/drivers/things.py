"""The things around simulated and emulated arms: they lie, are gripped, held and dropped.

Here is the truth about each thing, outside every driver. The arm learns of it from its jaw alone,
which is stopped by what is between the fingers. ``follow`` is told where the joints are, and

- finds what is between the fingers, and the jaw angle at which that stops the jaw: the thing lies
  on the fixed finger then, and the jaw on the thing;
- lets a thing that both touch move with the gripper, as long as the friction of the grip bears it;
- lets it fall straight down when the jaw opens or the grip is too weak, onto the floor or onto the
  box around what is below, and lie there on the nearest face it can lie on.

Not modelled: anything else. Things fall at once, do not roll, topple, swing or turn between the
fingers; nothing but the jaw pushes them, and only onto the fixed finger; they weigh on the table
until they leave it, and stop neither the arm nor a finger that comes down on them, but are then not
gripped. One thing is held at a time.

The surfaces of the fingers are those of the official solids, as in the robot description.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array, frozen_array, rotation_by

FRICTION = 0.5
"""Coefficient of friction between a finger and a thing; chosen: dry plastic on plastic."""

_G = 9.81  # [m/s^2]
_PATCH = 0.008  # lever on which a grip resists the turning of what it holds [m]; chosen
_TOUCHES = 0.001  # points so near to a finger are pressed when the nearest is [m]; chosen
_INTO = 0.003  # a finger deeper in a thing than this came down on it [m]; chosen
_LIFTED = 0.001  # a gripper that moved so far carries what it holds [m]; chosen
_OPENED = math.radians(0.6)  # a jaw so far from a thing has let it go [rad]; chosen
_REACH = 0.08  # of the fingers from their middle, more than enough [m]
_MIDDLE = np.array([0.0, 0.0, -0.08])  # of the space between the fingers

# In the frame of the gripper link: z against the approach, x from the fixed finger to the jaw [m].
_PAD_Z = np.array([-0.1044, -0.0945, -0.0843, -0.0651, -0.0451, -0.0380])  # along the fixed finger
_PAD_X = np.array([-0.0078, -0.0078, -0.0098, -0.0116, -0.0133, -0.0150])  # its surface
_PAD_HALF = np.array([0.0030, 0.0055, 0.0072, 0.0095, 0.0116, 0.0160])  # half its width
_PIVOT = np.array([0.0202, -0.0234])  # x and z of the jaw's axis
_JAW_XZ = np.array(
    [(-0.0084, -0.030), (-0.0084, -0.0618), (-0.0104, -0.0622), (-0.0104, -0.0716),
     (-0.0122, -0.0720), (-0.0122, -0.0815)]
)  # fmt: skip
"""The jaw's surface seen from its axis, at jaw angle zero."""
_JAW_R = np.hypot(*_JAW_XZ.T)
_JAW_ANGLE = np.arctan2(_JAW_XZ[:, 0], -_JAW_XZ[:, 1])
_JAW_HALF = np.array([0.0100, 0.0070, 0.0070, 0.0055, 0.0055, 0.0028])  # half its width
_JAW_LEAN = math.radians(10.8)  # of its surface over the steps, towards the fixed finger [rad]


class HandModel(Protocol):
    """What is asked of the arm's kinematics; ``RobotModel`` fits."""

    def frame(self, q: ArrayLike, name: str = ...) -> SE3: ...
    def gravity_torque(self, q_full: ArrayLike) -> Array: ...
    def with_payload(self, mass: float, p_tool: ArrayLike) -> Self: ...


@dataclass(slots=True, kw_only=True, eq=False)
class Thing:
    """A thing that can be gripped.

    Attributes:
        name: Its name.
        points: Points all over its surface, at most 4 mm apart, in its own frame, (n, 3), [m].
        com: Its centre of mass in its own frame, shape (3,), [m].
        faces: Outward normals of the faces it can lie on, shape (k, 3).
        mass: [kg].
        T_base: Where it is.
        friction: Its coefficient of friction on a finger.
    """

    name: str
    points: Array
    com: Array
    faces: Array
    mass: float
    T_base: SE3
    friction: float = FRICTION
    radius: float = field(init=False)

    def __post_init__(self) -> None:
        self.radius = float(np.linalg.norm(self.points - self.com, axis=1).max())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Support:
    """A box that things can fall on.

    Attributes:
        size: Its edges, shape (3,), [m].
        T_base: The pose of its middle.
    """

    size: Array
    T_base: SE3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Grip:
    """A thing between the fingers."""

    thing: Thing
    stop: float  # the jaw angle at which it stops the jaw [rad]
    T_hand_thing: SE3  # where it is in the gripper then
    steep: float  # between the line through both contacts and the surfaces' normals [rad]
    arm: float  # from the jaw's axis to the contact [m]
    p_hand: Array  # middle of the grip, shape (3,), [m]


class Things:
    """All things around one arm, and what its gripper does to them. Any thread may ask.

    Attributes:
        told: What happened to them last, one sentence each, for people; may be emptied.
    """

    def __init__(self, model: HandModel, *, floor_z: float | None) -> None:
        self.told = deque[str](maxlen=50)
        self._things = dict[str, Thing]()
        self._model, self._loaded = model, model
        self._floor_z, self._supports = floor_z, tuple[Support, ...]()
        zero = np.zeros(5)
        self._T_tool_hand = model.frame(zero).inverse @ model.frame(zero, "gripper_link")
        self._lock = threading.RLock()
        self._seen = b""  # joint angles since which nothing has changed
        self._stop = -math.inf  # what they gave
        self._q_jaw = -math.inf  # the jaw angle before [rad]
        self._near: str | None = None  # lies between the open fingers
        self._lost: str | None = None  # squeezed out of the jaw, which has not opened since
        self._lost_at = 0.0
        self._grip: _Grip | None = None  # touched by both fingers
        self._T_gripped: SE3 | None = None  # where the gripper touched it; None once it is carried

    # The truth, for tests and pictures

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._things)

    @property
    def held(self) -> str | None:
        """What both fingers touch, or None."""
        grip = self._grip
        return None if grip is None else grip.thing.name

    def where(self, name: str) -> SE3:
        """Where a thing is, in the base frame; ``ConfigError`` if there is none of that name."""
        return self._named(name).T_base

    # What people do to them

    def take_away(self, name: str) -> None:
        """Take a thing away for good, out of the gripper too."""
        with self._lock:
            thing = self._named(name)
            if self.held == name:
                self._let_go()
            del self._things[thing.name]
            self._seen = b""
            self.told.append(f"{name} was taken away")

    def put(self, thing: Thing) -> None:
        """Put a thing where it says, or one of that name there."""
        with self._lock:
            if self.held == thing.name:
                self._let_go()
            self._things[thing.name] = thing
            self._seen = b""

    def surround(self, floor_z: float | None, supports: Sequence[Support]) -> None:
        """Change what things fall on; nothing that lies moves."""
        with self._lock:
            self._floor_z, self._supports = floor_z, tuple(supports)

    # What an arm does to them

    def follow(self, q: Array, torque: float) -> float:
        """Take over where the joints are now; never waits.

        Args:
            q: Joint and jaw angles, shape (6,), [rad].
            torque: With which the jaw presses on what stops it [N m].

        Returns:
            The angle at which the jaw is stopped [rad]; minus infinity if nothing is in the way.
        """
        with self._lock:
            seen = q.tobytes()
            if self._grip is not None or seen != self._seen:
                self._seen, self._stop = seen, self._follow(q, torque)
            return self._stop

    def weight(self, q: Array) -> Array:
        """Torque with which the joints hold up what is carried, shape (6,), [N m]."""
        with self._lock:
            if self._loaded is self._model:
                return np.zeros(6)
            return self._loaded.gravity_torque(q) - self._model.gravity_torque(q)

    # How

    def _follow(self, q: Array, torque: float) -> float:
        if not self._things:
            return -math.inf
        T_hand, q_jaw = self._model.frame(q[:5], "gripper_link"), float(q[5])
        closes, self._q_jaw = q_jaw < self._q_jaw, q_jaw
        if self._lost is not None and q_jaw > self._lost_at + _OPENED:
            self._lost = None
        if self._grip is not None and self._stays(self._grip, T_hand, q_jaw, torque):
            return self._grip.stop
        grip = self._between(T_hand, q_jaw)
        self._near = None if grip is None else grip.thing.name
        if grip is None:
            return -math.inf
        if q_jaw <= grip.stop and not (closes and self._touch(grip, T_hand)):
            return -math.inf  # it was just let go, or is squeezed out
        return grip.stop

    def _named(self, name: str) -> Thing:
        if name not in self._things:
            known = ", ".join(self._things) or "none"
            raise ConfigError("thing", name, f"is not around this arm; there are: {known}")
        return self._things[name]

    def _between(self, T_hand: SE3, q_jaw: float) -> _Grip | None:
        """What the jaw meets first when it closes."""
        p_middle, found = T_hand @ _MIDDLE, None
        for thing in self._things.values():
            far = float(np.linalg.norm(thing.T_base @ thing.com - p_middle))
            if far > thing.radius + _REACH or thing.name == self._lost:
                continue
            grip = _grip_of(thing, T_hand, q_jaw, nears=self._near == thing.name)
            if grip is not None and (found is None or grip.stop > found.stop):
                found = grip
        return found

    def _touch(self, grip: _Grip, T_hand: SE3) -> bool:
        """Close on a thing; False if it is squeezed out."""
        name = grip.thing.name
        if grip.steep > math.atan(grip.thing.friction):
            self._lost, self._lost_at = name, grip.stop
            self.told.append(f"{name} was squeezed out of the fingers")
            return False
        self._grip, self._T_gripped = grip, T_hand
        grip.thing.T_base = T_hand @ grip.T_hand_thing
        self.told.append(f"{name} is gripped")
        return True

    def _stays(self, grip: _Grip, T_hand: SE3, q_jaw: float, torque: float) -> bool:
        """Carry what is gripped; False if it has just been let go or lost."""
        thing = grip.thing
        if q_jaw > grip.stop + _OPENED:
            self._let_go()
            self._fall(thing)
            return False
        if self._T_gripped is not None:
            moved = T_hand.p - self._T_gripped.p
            if float(np.linalg.norm(moved)) < _LIFTED:
                return True
        T_thing = T_hand @ grip.T_hand_thing
        aside = (T_thing @ thing.com - T_hand @ grip.p_hand)[:2]
        needed = thing.mass * _G * (1.0 + float(np.linalg.norm(aside)) / _PATCH)
        if 2.0 * thing.friction * torque / grip.arm < needed:
            self._let_go()
            self._fall(thing)
            return False
        if self._T_gripped is not None:
            self._T_gripped = None
            p_tool = self._T_tool_hand @ (grip.T_hand_thing @ thing.com)
            self._loaded = self._model.with_payload(thing.mass, p_tool)
        thing.T_base = T_thing
        return True

    def _let_go(self) -> None:
        self._grip = self._T_gripped = self._near = None
        self._loaded = self._model

    def _fall(self, thing: Thing) -> None:
        down = -thing.T_base.R[2]  # in its own frame
        face = thing.faces[int(np.argmax(thing.faces @ down))]
        axis = np.cross(thing.T_base.R @ face, (0.0, 0.0, -1.0))
        sine = float(np.linalg.norm(axis))
        if sine > 1e-9:
            angle = math.atan2(sine, -float((thing.T_base.R @ face)[2]))
            turn = rotation_by(axis * (angle / sine))
            p_com = thing.T_base @ thing.com
            R = turn @ thing.T_base.R
            thing.T_base = SE3(R, p_com - R @ thing.com)
        points = thing.points @ thing.T_base.R.T + thing.T_base.p
        drop = math.inf if self._floor_z is None else float(points[:, 2].min()) - self._floor_z
        for below in (*self._supports, *self._others(thing)):
            drop = min(drop, _room_above(below, points))
        if math.isinf(drop):
            self.told.append(f"{thing.name} fell out of the world: there is no floor")
            del self._things[thing.name]
            return
        thing.T_base = SE3(thing.T_base.R, thing.T_base.p - (0.0, 0.0, drop))
        x, y, z = (1000.0 * thing.T_base.p).tolist()
        self.told.append(f"{thing.name} lies at ({x:.1f}, {y:.1f}, {z:.1f}) mm")

    def _others(self, thing: Thing) -> Iterable[Support]:
        for other in self._things.values():
            if other is not thing:
                low, high = other.points.min(axis=0), other.points.max(axis=0)
                T = other.T_base @ SE3.from_translation(0.5 * (low + high))
                yield Support(size=high - low, T_base=T)


def _grip_of(thing: Thing, T_hand: SE3, q_jaw: float, *, nears: bool) -> _Grip | None:
    """How a thing stops the jaw; None if it is not between the fingers.

    Args:
        thing: The thing.
        T_hand: Where the gripper link is.
        q_jaw: The jaw angle [rad].
        nears: Whether it was between them before: the jaw may be pushing it to the fixed finger.
    """
    T = T_hand.inverse @ thing.T_base
    points = thing.points @ T.R.T + T.p
    x, y, z = points.T
    on_pad = (z >= _PAD_Z[0]) & (z <= _PAD_Z[-1]) & (np.abs(y) <= np.interp(z, _PAD_Z, _PAD_HALF))
    if not on_pad.any():
        return None
    gap = x - np.interp(z, _PAD_Z, _PAD_X)
    shift = -float(gap[on_pad].min())
    in_palm = (z > -0.036) & (np.abs(x) < 0.015) & (np.abs(y) < 0.02)
    if shift > _INTO or in_palm.any():
        return None
    if not nears and not -math.inf < _stops(x, y, z)[0].max() <= q_jaw:
        return None  # it is beyond the jaw, or the jaw has come down on it
    angles, r = _stops(x + shift, y, z)
    stop = float(angles.max())
    if not math.isfinite(stop):
        return None
    aside = np.array([shift, 0.0, 0.0])
    pressed = aside + points[(stop - angles) * r < _TOUCHES].mean(axis=0)
    lying = aside + points[on_pad & (gap + shift < _TOUCHES)]
    across = pressed - lying
    across /= np.linalg.norm(across, axis=1)[:, None]
    lean = stop - _JAW_LEAN
    n_jaw = np.array([math.cos(lean), 0.0, math.sin(lean)])
    cosines = np.minimum(across[:, 0], across @ n_jaw)
    best = int(np.argmax(cosines))
    return _Grip(
        thing=thing,
        stop=stop,
        T_hand_thing=SE3(T.R, T.p + aside),
        steep=math.acos(min(max(float(cosines[best]), -1.0), 1.0)),
        arm=float(np.hypot(pressed[0] - _PIVOT[0], pressed[2] - _PIVOT[1])),
        p_hand=frozen_array(0.5 * (pressed + lying[best]), (3,)),
    )


def _stops(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """The jaw angle [rad] at which the jaw touches each point, or minus infinity; their radii."""
    dx, dz = x - _PIVOT[0], z - _PIVOT[1]
    r = np.hypot(dx, dz)
    angles = np.arctan2(dx, -dz) - np.interp(r, _JAW_R, _JAW_ANGLE)
    met = (r >= _JAW_R[0]) & (r <= _JAW_R[-1]) & (np.abs(y) <= np.interp(r, _JAW_R, _JAW_HALF))
    return np.where(met, angles, -math.inf), r


def _room_above(below: Support, points: Array) -> float:
    """How far points, shape (n, 3), can go down until the first meets a box [m]; maybe infinite.

    Points that are in the box by less than half of it give a negative number.
    """
    half = 0.5 * below.size
    start = (points - below.T_base.p) @ below.T_base.R
    along = -below.T_base.R[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(-half - start) / along, (half - start) / along])
    enters = np.nanmax(ends.min(axis=0), axis=1)
    leaves = np.nanmin(ends.max(axis=0), axis=1)
    met = (enters < leaves) & (leaves > -enters)
    return float(enters[met].min()) if met.any() else math.inf
