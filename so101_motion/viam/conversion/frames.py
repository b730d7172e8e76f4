"""Find where the machine's frames are in one arm's base frame.

The arm's base (``<arm>_origin``), its tool (``<arm>``) and the transforms of a request are known
here; for others, such as the world, the machine is asked. A frame is *held* when it is attached to
the arm's tool, directly or through other frames.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping
from typing import TYPE_CHECKING, TypeVar

from grpclib import GRPCError
from grpclib.exceptions import StreamTerminatedError
from h2.exceptions import ProtocolError
from viam.proto.common import Pose, PoseInFrame, Transform

from so101_motion.common.attributes import suggest
from so101_motion.common.errors import ConfigError, MachineUnavailable
from so101_motion.common.geometry import SE3
from so101_motion.viam.conversion import convert

if TYPE_CHECKING:
    from viam.robot.client import RobotClient

T = TypeVar("T")

WORLD = "world"  # the root of all frames

GIVE_FRAME = """give each a frame in the machine's configuration ("frame": {"parent": "world"})"""

CONNECTED_WITHIN = 5.0
"""How long a lost connection to the machine is waited for [s]; chosen: the SDK tries once a second
to connect again."""

_PAUSE = 0.05  # [s] between two tries


class _Here:
    machine: Callable[[], RobotClient | None] = staticmethod(lambda: None)


def set_machine(machine: Callable[[], RobotClient | None]) -> None:
    """Set the connection to the machine; called once, by the module."""
    _Here.machine = staticmethod(machine)


def machine_here() -> RobotClient | None:
    """The machine of this process; None while it cannot be reached."""
    return _Here.machine()


async def asked(ask: Callable[[], Awaitable[T]]) -> T:
    """Ask the machine, and again while the SDK connects anew."""
    loop = asyncio.get_running_loop()
    end = loop.time() + CONNECTED_WITHIN
    while True:
        try:
            return await ask()
        except (OSError, StreamTerminatedError, ProtocolError) as error:
            if loop.time() >= end:
                raise MachineUnavailable(
                    "viam-server", f"the module lost its connection to it ({error}); ask again"
                ) from error
        await asyncio.sleep(_PAUSE)


async def parents() -> Mapping[str, str]:
    """The parent of each frame of the machine; empty if there is no machine."""
    machine = machine_here()
    parts = await asked(machine.get_frame_system_config) if machine is not None else []
    return {
        part.frame.reference_frame: part.frame.pose_in_observer_frame.reference_frame
        for part in parts
    }


async def carrier(
    frame: str,
    arms: Collection[str],
    transforms: Iterable[Transform] = (),
    above: Callable[[], Awaitable[Mapping[str, str]]] = parents,
) -> str | None:
    """The arm to which ``frame`` is attached; None if to none."""
    brought = {each.reference_frame: each.pose_in_observer_frame for each in transforms}
    trail: list[str] = []
    known: Mapping[str, str] = {}
    while frame != WORLD and frame not in arms:
        _note(frame, trail)
        if frame in brought:
            frame = brought[frame].reference_frame
        else:
            known = known or await above()
            frame = known.get(frame.removesuffix("_origin"), WORLD)
    return frame if frame in arms else None


LONGEST_CHAIN = 100
"""Most frames between a frame and the root. Chosen."""


def _note(frame: str, trail: list[str]) -> None:
    """Add a frame to those below it; refuses a chain that is too long or leads to itself."""
    if frame in trail:
        raise ConfigError("transforms", frame, "is attached to itself: " + " - ".join(trail))
    trail.append(frame)
    if len(trail) > LONGEST_CHAIN:
        raise ConfigError("transforms", trail[0], f"has more than {LONGEST_CHAIN} parents")


class Frames:
    """The frames around one arm, for one request.

    ``placed`` gives the pose of a frame of the machine in the base frame; None for one that the
    machine must be asked for.
    """

    def __init__(
        self,
        arm: str,
        T_base_tool: SE3,
        transforms: Iterable[Transform] = (),
        *,
        placed: Callable[[str], SE3 | None] | None = None,
        parents: Mapping[str, str] | None = None,
    ) -> None:
        self.arm, self.tool = arm, T_base_tool
        self._known: dict[str, SE3] = {f"{arm}_origin": SE3.identity(), arm: T_base_tool}
        self._brought: dict[str, Transform] = {}
        self._placed = placed
        self._parents = parents
        for transform in transforms:
            name = transform.reference_frame
            if not name or not transform.HasField("pose_in_observer_frame"):
                raise ConfigError("transforms", name, "each needs a name, and a pose in a frame")
            if name in self._brought or name in self._known:
                raise ConfigError("transforms", name, "is the name of another frame")
            self._brought[name] = transform

    async def T_base(self, frame: str) -> SE3:
        """The pose of ``frame`` now, in the arm's base frame."""
        trail: list[str] = []
        while frame in self._brought and frame not in self._known:
            _note(frame, trail)
            frame = self._brought[frame].pose_in_observer_frame.reference_frame
        if frame not in self._known:
            known = None if self._placed is None else self._placed(frame)
            self._known[frame] = known or await self._ask(frame, f"{self.arm}_origin")
        T_base_frame = self._known[frame]
        for name in reversed(trail):
            T_base_frame @= convert.from_pose(self._brought[name].pose_in_observer_frame.pose)
            self._known[name] = T_base_frame
        return T_base_frame

    async def T_tool(self, frame: str) -> SE3:
        """The pose of ``frame`` in the arm's tool frame."""
        if not await self.is_held(frame):
            raise ConfigError(
                "component_name", frame, f"is not attached to {self.arm}, so it cannot be moved"
            )
        if frame in self._brought:
            seen = self._brought[frame].pose_in_observer_frame
            return await self.T_tool(seen.reference_frame) @ convert.from_pose(seen.pose)
        return SE3.identity() if frame == self.arm else await self._ask(frame, self.arm)

    async def is_held(self, frame: str) -> bool:
        """Whether ``frame`` moves with the arm's tool."""
        arms, brought = (self.arm, f"{self.arm}_origin"), self._brought.values()

        async def machine_parents() -> Mapping[str, str]:
            if self._parents is None:
                self._parents = await parents()
            return self._parents

        return await carrier(frame, arms, brought, machine_parents) == self.arm

    async def _ask(self, frame: str, seen_from: str) -> SE3:
        machine = machine_here()
        if machine is None:
            raise self._unknown(frame, "there is no connection to the machine")
        # The identity; an orientation vector of zeros is not sent.
        origin = PoseInFrame(reference_frame=frame, pose=Pose(o_z=1.0))
        try:
            seen = await asked(lambda: machine.transform_pose(origin, seen_from))
        except GRPCError as error:
            raise self._unknown(frame, str(error.message)) from error
        return convert.from_pose(seen.pose)

    def _unknown(self, frame: str, why: str) -> ConfigError:
        where = f"its pose seen from {self.arm} is not known ({why}); {GIVE_FRAME}"
        if frame == WORLD:
            return ConfigError("reference_frame", frame, f"{where}, or name {self.arm}_origin")
        names = (*self._known, *self._brought, WORLD)
        return ConfigError("reference_frame", frame, f"{where}. {suggest(frame, names)}")
