"""Read what the machine's components look like and where they are, seen from one arm.

Everything with a frame counts: the geometry in its frame's configuration, and what it answers to
``GetGeometries``. Another arm of this process is where its joints are, with the hulls of its links;
the arm's own links and grippers are known better than any answer says. What hangs from the arm's
tool is held, everything else stands where it is at that moment.

The machine is asked anew for each plan. An answer that says what the last one said gives the same
bodies, so that a planner need not build them again. Who has no geometries is asked again only when
the configuration has changed, or after a while.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Collection, Coroutine, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Protocol, TypeVar

import numpy as np
import so101_description
from grpclib import GRPCError, Status
from viam.errors import ResourceNotFoundError
from viam.proto.common import Geometry, Pose, PoseInFrame, ResourceName, Transform
from viam.proto.robot import FrameSystemConfig

from so101_motion.common.errors import ConfigError, SurroundingsUnknown, clipped
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import (
    FLOOR,
    LARGEST,
    LINKS,
    Attached,
    Mesh,
    Obstacle,
    Scene,
    Shape,
    ShapeFile,
)
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.frames import WORLD, Frames, machine_here
from so101_motion.viam.conversion.geometries import from_geometry
from so101_motion.viam.conversion.world_state import MOST_THINGS, UniqueNames, taken_in
from so101_motion.viam.surroundings.frame_tree import FrameTree, Part

Answer = TypeVar("Answer")

LONGEST_READ = 2.0
"""How long the machine may take to answer [s]. Chosen: a hundred times what it takes."""

ALL = "*"
"""The name that leaves out all components."""

_SAME = 1.5e-3
"""Who has moved less is taken to stand where it stood [m]. Chosen: a tick or two of a servo that
holds move its tool by that much, and the planner keeps 3 mm from everything."""

_LEVER = 0.2
"""How far what turns with a frame is from it [m]; chosen, twice the length of a gripper."""

_ASK_AGAIN = 5.0
"""After how long those without geometries are asked again [s]; chosen."""

_HAS_NONE = ("unimplemented", "not implemented", "unsupported")
"""What modules in other languages say for UNIMPLEMENTED."""


class NeighbourArm(Protocol):
    """An arm of this process."""

    async def found(self) -> None:
        """Wait until its joints can be read."""

    def T_end(self) -> SE3:
        """Where its tool is in its base frame."""

    def T_links(self) -> Mapping[str, SE3]:
        """Where its links are in its base frame, by their URDF names."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """One thing of the machine.

    Attributes:
        component: The component it belongs to.
        name: What messages call it; more than one thing may have it.
        shape: Its form.
        T: Where it is: in the base frame of the arm, of what is held in its tool frame.
        held: Whether it moves with the tool.
    """

    component: str
    name: str
    shape: Shape | ShapeFile
    T: SE3
    held: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MachineView:
    """The machine as it was at one moment, seen from one arm.

    Attributes:
        arm: The arm's short name.
        bodies: What stands around it and what it holds.
        tree: The frame system; None if nothing is known of it.
        ends: Where the ends of components with kinematics are in their origins.
        T_base_tool: Where the arm's tool is.
        T_links: Where its links are in its base frame, by their URDF names.
        read_again: Gives the machine as it is when it is called.
    """

    arm: str
    bodies: tuple[Body, ...] = ()
    tree: FrameTree | None = None
    ends: Mapping[str, SE3]
    T_base_tool: SE3
    T_links: Mapping[str, SE3]
    read_again: Callable[[], Awaitable[MachineView]]

    @property
    def own_frames(self) -> set[str]:
        """The frames of the machine, which nothing else may be called."""
        names = set() if self.tree is None else set(self.tree.parts)
        return {WORLD, *names, *(f"{name}_origin" for name in (*names, self.arm)), self.arm}

    def frames(self, transforms: Iterable[Transform] = ()) -> Frames:
        """The same frames, and those that ``transforms`` bring along.

        Raises:
            ConfigError: A transform cannot be meant.
        """
        if self.tree is None:
            return Frames(self.arm, self.T_base_tool, transforms)
        parents = {name: part.parent for name, part in self.tree.parts.items()}
        placed = self._placed
        return Frames(self.arm, self.T_base_tool, transforms, placed=placed, parents=parents)

    def _placed(self, frame: str) -> SE3 | None:
        """Where a frame of the machine is in the arm's base frame; None if it is not known."""
        tree = self.tree
        if tree is None or (frame != WORLD and not tree.has(frame)):
            return None
        part = tree.parts.get(frame)
        if part is not None and part.has_end and frame not in self.ends:
            return None  # nothing hangs from there, so it was not asked for
        return tree.T_world(f"{self.arm}_origin", self.ends).inverse @ tree.T_world(
            frame, self.ends
        )


class MachineBodies:
    """Reads the machine for one arm.

    Args:
        arm: The arm's short name.
        left_out: Components that do not count; ``ALL`` for none that does.
        arms: The arms of this process by name, as they come and go.
        grippers: The names of the grippers of this process.
        patience: How long the machine may take to answer [s].

    Attributes:
        without: Why nothing of the machine is known although nothing is wrong; empty if it is.
    """

    def __init__(
        self,
        arm: str,
        left_out: Collection[str],
        arms: Mapping[str, NeighbourArm],
        grippers: Collection[str],
        *,
        patience: float = LONGEST_READ,
    ) -> None:
        self.without = ""
        self._patience = patience
        self._arm, self._left_out = arm, frozenset(left_out)
        self._arms, self._grippers = arms, grippers
        self._configs: list[FrameSystemConfig] = []
        self._tree = FrameTree(())
        self._shapeless: dict[str, float] = {}  # who has no geometries, and since when
        self._ends: dict[str, SE3] = {}
        self._links: dict[str, Mapping[str, SE3]] = {}
        self._shapes: dict[str, tuple[bytes, Shape | ShapeFile]] = {}
        self._one_at_a_time = asyncio.Lock()

    @property
    def is_asked(self) -> bool:
        """Whether there is a machine that could say something."""
        return ALL not in self._left_out and machine_here() is not None

    async def read(self) -> MachineView:
        """The machine as it is now.

        Raises:
            SurroundingsUnknown: It does not answer in time, or something in it cannot be meant.
        """
        if not self.is_asked:
            return self._nothing()
        try:
            async with asyncio.timeout(self._patience), self._one_at_a_time:
                return await self._read()
        except TimeoutError as error:
            reason = f"the machine has not said within {self._patience:g} s what its components are"
            raise SurroundingsUnknown(reason) from error
        except ConfigError as error:
            raise SurroundingsUnknown(f"the machine says {error}") from error

    def _nothing(self) -> MachineView:
        return self._view((), None, {})

    def _view(
        self, bodies: tuple[Body, ...], tree: FrameTree | None, ends: Mapping[str, SE3]
    ) -> MachineView:
        own = self._arms[self._arm]
        T_base_tool = ends.get(self._arm) or own.T_end()
        return MachineView(
            arm=self._arm, bodies=bodies, tree=tree, ends=ends, T_base_tool=T_base_tool,
            T_links=own.T_links(), read_again=self.read,
        )  # fmt: skip

    async def _read(self) -> MachineView:
        machine = machine_here()
        assert machine is not None, "is_asked"
        try:
            configs = await machine.get_frame_system_config()
        except GRPCError as error:
            if error.status is Status.UNIMPLEMENTED:
                self.without = "the machine has no frame system"
                return self._nothing()
            reason = f"the machine does not tell its frame system: {_words(error)}"
            raise SurroundingsUnknown(reason) from error
        except OSError as error:
            raise SurroundingsUnknown(f"the machine cannot be reached: {error}") from error
        if configs != self._configs:
            tree = await asyncio.to_thread(FrameTree, configs)
            self._configs, self._tree = configs, tree
            self._shapeless.clear()
            self._ends.clear()
            self._shapes.clear()
        if self._arm not in self._tree.parts:
            self.without = f'"{self._arm}" has no frame in the machine\'s configuration'
            return self._nothing()
        self.without = ""
        counted = [part for name, part in self._tree.parts.items() if name not in self._left_out]
        answers = await _all(self._geometries(part) for part in counted)
        ends = await self._all_ends()
        given = sum(len(answer) for answer in answers)
        if given > MOST_THINGS:
            reason = f"the machine has {given} geometries, more than the {MOST_THINGS} planned with"
            raise SurroundingsUnknown(reason)
        links = {
            part.name: self._links_of(part.name)
            for part in counted
            if part.name in self._arms and part.name != self._arm
        }
        bodies = await asyncio.to_thread(self._placed, counted, answers, ends, links)
        return self._view(bodies, self._tree, ends)

    # Where components are

    async def _all_ends(self) -> dict[str, SE3]:
        names = sorted(self._tree.ends_needed() | {self._arm})
        return dict(zip(names, await _all(map(self._end, names)), strict=True))

    async def _end(self, name: str) -> SE3:
        """Where the end of a component's kinematics is in its origin."""
        known = self._ends.get(name)
        if name in self._arms:
            if name != self._arm:
                await self._found(name)
            return self._arms[name].T_end()
        if known is not None and not self._tree.parts[name].has_joints:
            return known
        machine = machine_here()
        assert machine is not None
        query = PoseInFrame(reference_frame=name, pose=Pose(o_z=1.0))
        try:
            seen = await machine.transform_pose(query, f"{name}_origin")
        except GRPCError as error:
            reason = f'the machine does not tell where "{name}" is: {_words(error)}'
            raise SurroundingsUnknown(reason, component=name) from error
        T = convert.from_pose(seen.pose)
        if known is not None and nearly(T, known):
            return known
        self._ends[name] = T
        return T

    async def _found(self, name: str) -> None:
        try:
            await self._arms[name].found()
        except GRPCError as error:
            reason = f'nobody knows where "{name}" is: {_words(error)}'
            raise SurroundingsUnknown(reason, component=name) from error

    # What they look like

    async def _geometries(self, part: Part) -> list[Geometry]:
        """What a component answers, and what its frame's configuration says."""
        own = [part.geometry] if part.geometry is not None else []
        if part.name in self._arms or part.name in self._grippers:
            if part.name in self._arms and part.name != self._arm:
                await self._found(part.name)
            return own
        since = self._shapeless.get(part.name)
        if since is not None and time.monotonic() - since < _ASK_AGAIN:
            return own
        try:
            answer = await self._ask(part.name)
        except SurroundingsUnknown:
            if own:
                return own
            raise
        if answer:
            self._shapeless.pop(part.name, None)
        else:
            self._shapeless[part.name] = time.monotonic()
        return [*own, *answer]

    async def _ask(self, name: str) -> list[Geometry]:
        machine = machine_here()
        assert machine is not None
        resource = _component(machine.resource_names, name)
        if resource is None:
            await machine.refresh()
            resource = _component(machine.resource_names, name)
        if resource is None:
            reason = f'"{name}" has a frame but does not run, so nobody knows what it is like'
            raise SurroundingsUnknown(reason, component=name)
        try:
            client = machine.get_component(resource)
        except ResourceNotFoundError:
            return []  # of an API that this SDK does not know
        try:
            return list(await client.get_geometries(timeout=self._patience))
        except NotImplementedError:
            return []
        except (GRPCError, OSError) as error:
            if isinstance(error, GRPCError) and _has_none(error):
                return []
            reason = f'"{name}" does not tell its geometries: {_words(error)}'
            raise SurroundingsUnknown(reason, component=name) from error

    # Both together

    def _placed(
        self,
        parts: list[Part],
        answers: list[list[Geometry]],
        ends: Mapping[str, SE3],
        links: Mapping[str, Mapping[str, SE3]],
    ) -> tuple[Body, ...]:
        tree = self._tree
        T_base_world = tree.T_world(f"{self._arm}_origin", ends).inverse
        T_tool_world = tree.T_world(self._arm, ends).inverse
        bodies: list[Body] = []
        for part, geometries in zip(parts, answers, strict=True):
            held = tree.is_held(part.name, self._arm)
            T_world_origin = tree.T_world(f"{part.name}_origin", ends)
            T = (T_tool_world if held else T_base_world) @ T_world_origin
            for i, geometry in enumerate(geometries):
                shape, center = self._shape(part.name, i, geometry)
                name = part.name
                if geometry is not part.geometry:
                    name = _called(part.name, geometry.label, len(geometries))
                bodies.append(
                    Body(component=part.name, name=name, shape=shape, T=T @ center, held=held)
                )
            for link, at in links.get(part.name, {}).items():
                human, hull = link_hulls()[link]
                name = f"{part.name}:{human}"
                bodies.append(Body(component=part.name, name=name, shape=hull, T=T @ at, held=held))
        return tuple(bodies)

    def _shape(self, name: str, i: int, geometry: Geometry) -> tuple[Shape | ShapeFile, SE3]:
        """Its form and the place of it; the very same objects for the same message."""
        key, message = f"{name}/{i}", geometry.SerializeToString(deterministic=True)
        known = self._shapes.get(key)
        try:
            if known is None or known[0] != message:
                known = self._shapes[key] = (message, from_geometry(geometry))
            has_center = geometry.HasField("center")
            center = convert.from_pose(geometry.center) if has_center else SE3.identity()
        except ConfigError as error:
            raise SurroundingsUnknown(
                f'the geometry of "{name}" cannot be meant: {error}', component=name
            ) from error
        return known[1], center

    def _links_of(self, name: str) -> Mapping[str, SE3]:
        now, before = self._arms[name].T_links(), self._links.get(name)
        if before is None or not all(nearly(now[link], before[link]) for link in now):
            before = self._links[name] = now
        return before


def scene_around(scene: Scene, bodies: tuple[Body, ...]) -> Scene:
    """A scene with what the machine has added to it.

    Raises:
        ConfigError: Something cannot be planned with.
    """
    names = UniqueNames(taken_in(scene))
    obstacles, attached = list(scene.obstacles), list(scene.attached)
    for body in bodies:
        is_far = float(np.abs(body.T.p).max()) > LARGEST
        if is_far and not isinstance(body.shape, ShapeFile):
            continue  # no shape is larger, so this one cannot be met
        is_taken = body.name in (FLOOR, *LINKS)
        name = names.new(f"{body.name} (component)" if is_taken else body.name)
        if body.held:
            attached.append(Attached(name=name, shape=body.shape, T_tool_object=body.T))
        else:
            obstacles.append(Obstacle(name=name, shape=body.shape, T_base_obstacle=body.T))
    return replace(scene, obstacles=tuple(obstacles), attached=tuple(attached))


@cache
def link_hulls() -> dict[str, tuple[str, Mesh]]:
    """The hull of each link of an arm with the name of its part, by the link's URDF name."""
    hulls = {}
    for link, part in so101_description.PARTS.items():
        hull = so101_description.load_hull(part)
        mesh = Mesh(vertices=hull.vertices, triangles=hull.faces)
        hulls[link] = (part.replace("_", " "), mesh)
    return hulls


async def _all(asked: Iterable[Coroutine[Any, Any, Answer]]) -> list[Answer]:
    """All answers, asked for at once; nothing goes on once one has failed."""
    tasks = [asyncio.ensure_future(each) for each in asked]
    try:
        return await asyncio.gather(*tasks)
    finally:
        for task in tasks:
            task.cancel()


def nearly(T: SE3, other: SE3, distance: float = _SAME) -> bool:
    """Whether nothing that hangs there has moved by as much as ``distance`` [m]."""
    turned = float(np.linalg.norm(T.R - other.R)) * _LEVER
    return float(np.linalg.norm(T.p - other.p)) + turned < distance


def _component(names: list[ResourceName], name: str) -> ResourceName | None:
    wanted = [each for each in names if each.type == "component" and each.name == name]
    return wanted[0] if wanted else None


def _called(component: str, label: str, count: int) -> str:
    """What messages call a geometry: by its component, and by its label if that has several."""
    label = clipped(label.removeprefix(f"{component}:"), 80)
    return component if count == 1 or label in ("", component) else f"{component}:{label}"


def _has_none(error: GRPCError) -> bool:
    told = (error.message or "").lower()
    return error.status is Status.UNIMPLEMENTED or any(word in told for word in _HAS_NONE)


def _words(error: GRPCError | OSError) -> str:
    return str(error.message if isinstance(error, GRPCError) else error)
