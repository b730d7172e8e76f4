"""Read the shapes and poses of the machine's components, seen from one arm.

Every component with a frame counts, with the geometry of its frame's configuration and its answer
to ``GetGeometries``. For another arm of this process the hulls of its links are used, and this
arm's own links and grippers are left out: the planner has them. A component attached to the arm's
tool is held; all others stand where they are at that moment. Arms that share a cell with this one,
and what they hold, are left to the cell, which knows their motions.

The machine is read for each plan. An unchanged answer gives the same body objects, so that the
planner need not rebuild them. A call takes a third of a millisecond of this process, so a component
whose answer adds nothing to its frame's configuration is asked again only after a while. No call
has a time limit of its own, which would take a tenth more.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Coroutine, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from grpclib import GRPCError, Status
from grpclib.exceptions import StreamTerminatedError
from viam.errors import ResourceNotFoundError
from viam.proto.common import Geometry, Pose, PoseInFrame, ResourceName
from viam.proto.robot import FrameSystemConfig, ResourceStatus

from so101_motion.arm.cell_member import ALL
from so101_motion.common.errors import ConfigError, SurroundingsUnknown, clipped
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Attached, Shape, ShapeFile
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.frames import machine_here
from so101_motion.viam.conversion.geometries import from_geometry
from so101_motion.viam.conversion.world_state import MOST_THINGS
from so101_motion.viam.surroundings.machine_cell import MachineCell, held_by
from so101_motion.viam.surroundings.machine_view import (
    Body,
    FrameTree,
    MachineView,
    Part,
    link_hulls,
    nearly,
)

if TYPE_CHECKING:
    from viam.robot.client import RobotClient

_LEFT_OUT = ("arm", "gantry")
"""Kinds that viam-server leaves out of the frame system while they do not run, as if the machine
had none. Grippers are too, but each is attached to one of these."""

_RUNS = (ResourceStatus.STATE_READY, ResourceStatus.STATE_UNSPECIFIED)

REMOTE = "_world"
"""The end of the frame's name of a remote machine, which is no component. Its parts are missing
while it is not connected."""

Answer = TypeVar("Answer")

LONGEST_READ = 2.0
"""How long the machine may take to answer [s]. Chosen: a hundred times what it takes."""

_LOST = (OSError, StreamTerminatedError)  # the errors of a call without a connection

_STARTING = 0.05
"""Pause between two tries while a component starts or the connection is lost [s]; chosen."""


_ASK_AGAIN = 5.0  # how long until a component is asked again whose answer added nothing [s]; chosen

_HAS_NONE = ("unimplemented", "not implemented", "unsupported")
"""Words that modules in other languages send for UNIMPLEMENTED."""


class NeighbourArm(Protocol):
    """An arm of this process; poses are in its base frame, those of links by their URDF names."""

    async def found(self) -> None: ...
    def T_end(self) -> SE3: ...
    def T_links(self) -> Mapping[str, SE3]: ...


class MachineBodies:
    """Reads the machine's components for one arm, which ignores those ``left_out`` (or ``ALL``).

    ``without`` is why the components are unknown though there is no error; else empty.
    """

    def __init__(
        self,
        arm: str,
        left_out: Collection[str],
        arms: Mapping[str, NeighbourArm],
        grippers: Collection[str],
        cell: MachineCell,
    ) -> None:
        self.without = ""
        self._cell, self._mates = cell, frozenset[str]()
        self._arm, self._left_out = arm, frozenset(left_out)
        self._arms, self._grippers = arms, grippers
        self._configs: list[FrameSystemConfig] | None = None
        self._tree = FrameTree(())
        self._plain: dict[str, float] = {}  # components whose answers added nothing, and when
        self._counted: list[Part] = []  # the components that are not left out
        self._ends: dict[str, SE3] = {}
        self._links: dict[str, Mapping[str, SE3]] = {}
        self._shapes: dict[str, tuple[bytes, Shape | ShapeFile]] = {}
        self._changes = 0  # of the configuration, and of where the links of other arms are
        self._asked: tuple[object, ...] = ()
        self._bodies: tuple[Body, ...] = ()
        self._held: dict[str, tuple[Attached, ...]] = {}  # by arms of the cell
        self._one_at_a_time = asyncio.Lock()

    @property
    def has_company(self) -> bool:
        return len(self._arms) > 1 and self.is_asked

    @property
    def company(self) -> tuple[object, ...]:
        """A key that changes when other arms come, go, move or hold something else."""
        return (self._changes, self._mates, self._held)

    @property
    def is_asked(self) -> bool:
        return ALL not in self._left_out and machine_here() is not None

    async def read(self) -> MachineView:
        """Read the machine as it is now; ``SurroundingsUnknown`` if it does not answer in time."""
        if not self.is_asked:
            return self._view((), None, {})
        reason = f"the machine has not listed its components within {LONGEST_READ:g} s"
        try:
            async with asyncio.timeout(LONGEST_READ), self._one_at_a_time:
                while True:
                    try:
                        return await self._read()
                    except _LOST as error:  # the SDK connects again
                        reason = f"the machine cannot be reached: {error}"
                    await asyncio.sleep(_STARTING)
        except TimeoutError as error:
            raise SurroundingsUnknown(reason) from error
        except ConfigError as error:
            component = str(error.value) if error.key == "frame" else ""
            raise SurroundingsUnknown(f"the machine says {error}", component=component) from error

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
        # Components are asked while the frame system is: mostly that has not changed.
        early = asyncio.ensure_future(self._all_geometries(self._counted))
        try:
            return await self._read_frames(early)
        finally:
            early.cancel()
            await asyncio.wait([early])
            early.cancelled() or early.exception()  # looked at, so that nobody reports it

    async def _read_frames(self, early: asyncio.Future[list[list[Geometry]]]) -> MachineView:
        before = self._configs
        try:
            configs = await self._frame_system()
        except GRPCError as error:
            if error.status is Status.UNIMPLEMENTED:
                self.without = "the machine has no frame system"
                return self._view((), None, {})
            reason = f"the machine does not report its frame system: {error.message or ''}"
            raise SurroundingsUnknown(reason) from error
        if configs != self._configs:
            tree = await asyncio.to_thread(FrameTree, configs, self._left_out)
            self._configs, self._tree = configs, tree
            self._changes += 1
            self._plain.clear()
            self._ends.clear()
            self._shapes.clear()
            self._counted = [
                part for name, part in tree.parts.items() if name not in self._left_out
            ]
        if self._arm not in self._tree.parts:
            for part in self._tree.parts.values():
                # viam-server cannot place what is attached to a frame by another name.
                if part.kinematics == self._arm:
                    raise SurroundingsUnknown(
                        f'the frame of "{self._arm}" is called "{part.name}" in the machine',
                        remedy='take the "id" out of its frame\'s configuration',
                    )
            self.without = f'"{self._arm}" has no frame in the machine\'s configuration'
            return self._view((), None, {})
        self.without = ""
        counted = self._counted
        answers = await (early if configs == before else self._all_geometries(counted))
        needed = sorted(self._tree.ends_needed() | {self._arm})
        ends = dict(zip(needed, await _all(map(self._end, needed)), strict=True))
        given = sum(len(answer) for answer in answers)
        if given > MOST_THINGS:
            reason = f"the machine has {given} geometries, more than the {MOST_THINGS} planned with"
            raise SurroundingsUnknown(reason)
        await self._meet(ends)
        links = {
            part.name: self._links_of(part.name)
            for part in counted
            if part.name in self._arms and part.name not in (self._arm, *self._mates)
        }
        asked = self._fingerprint(answers, ends)
        if asked != self._asked:
            bodies = await asyncio.to_thread(self._placed, counted, answers, ends, links)
            self._asked = asked
            self._bodies = tuple(each for each in bodies if each.holder not in self._mates)
            self._held = held_by(bodies, {self._arm, *self._mates})
        self._cell.know(self._arm, self._held)
        return self._view(self._bodies, self._tree, ends)

    async def _frame_system(self) -> list[FrameSystemConfig]:
        """The frame system once every component that belongs into it runs."""
        machine = _machine()
        configs = await _listed(machine)
        if configs == self._configs:
            return configs
        while missing := [
            each
            for each in await _components(machine)
            if each.name.subtype in _LEFT_OUT
            and not each.remote
            and each.name.name not in self._left_out
            and each.state not in _RUNS
        ]:
            for each in missing:
                if each.error:  # else it is being configured
                    why = clipped(each.error, 300)
                    reason = f'"{each.name.name}" does not run, so its place is unknown: {why}'
                    raise SurroundingsUnknown(reason, component=each.name.name)
            await asyncio.sleep(_STARTING)
        configs = await _listed(machine)
        there = {*self._left_out, *(each.frame.reference_frame for each in configs)}
        before = self._tree.parts
        remote = {n: p.parent for n, p in before.items() if p.parent.endswith(REMOTE)}
        gone = [name for name, world in remote.items() if world in before.keys() - there]
        listed = {each.name.name for each in await _components(machine)} if gone else set()
        for lost in gone:
            if lost in listed:
                reason = f'the remote machine that has "{lost}" is not connected'
                raise SurroundingsUnknown(reason, component=remote[lost])
        return configs

    async def _meet(self, ends: Mapping[str, SE3]) -> None:
        here = self._arms.keys() & self._tree.parts.keys()
        bases = {name: self._tree.T_world(f"{name}_origin", ends) for name in here}
        mates = await asyncio.to_thread(self._cell.meet, self._arm, bases)
        if mates != self._mates:
            self._mates = mates
            self._changes += 1

    def _fingerprint(
        self, answers: list[list[Geometry]], ends: Mapping[str, SE3]
    ) -> tuple[object, ...]:
        """A key that changes when a body does; this arm's own tool pose changes none."""
        messages = [each.SerializeToString(deterministic=True) for many in answers for each in many]
        places = [(each, T.p.tobytes(), T.R.tobytes()) for each, T in ends.items()]
        others = [each for each in places if each[0] not in (self._arm, *self._mates)]
        return (self._changes, [len(many) for many in answers], messages, others)

    # Where components are

    async def _end(self, name: str) -> SE3:
        known = self._ends.get(name)
        if name == self._arm:
            return self._arms[name].T_end()
        if name in self._arms:
            await self._found(name)
            now = self._arms[name].T_end()
        elif known is not None and not self._tree.parts[name].has_joints:
            return known
        else:
            query = PoseInFrame(reference_frame=name, pose=Pose(o_z=1.0))
            with _needed(f'the machine does not report where "{name}" is', name):
                seen = await _machine().transform_pose(query, f"{name}_origin")
            now = convert.from_pose(seen.pose)
        self._ends[name] = known if known is not None and nearly(now, known) else now
        return self._ends[name]

    async def _found(self, name: str) -> None:
        with _needed(f'the place of "{name}" is unknown', name):
            await self._arms[name].found()

    # Shapes of components

    async def _all_geometries(self, parts: list[Part]) -> list[list[Geometry]]:
        """The geometries in each component's answer and in its frame's configuration."""
        found = [[] if part.geometry is None else [part.geometry] for part in parts]
        asked = [k for k, part in enumerate(parts) if self._has_to_be_asked(part.name)]
        answers = await _all(self._geometries(parts[k].name, found[k]) for k in asked)
        for k, answer in zip(asked, answers, strict=True):
            found[k] = answer
        return found

    def _has_to_be_asked(self, name: str) -> bool:
        if name in self._arms:
            return name != self._arm
        since = self._plain.get(name)
        is_due = since is None or time.monotonic() - since >= _ASK_AGAIN
        return name not in self._grippers and is_due

    async def _geometries(self, name: str, own: list[Geometry]) -> list[Geometry]:
        if name in self._arms:
            await self._found(name)
            return own
        try:
            answer = await _ask(name)
        except SurroundingsUnknown:
            if own:
                return own
            raise
        if all(_is_among(each, own) for each in answer):
            self._plain[name] = time.monotonic()
            return own
        self._plain.pop(name, None)
        # Of a component without a geometry in its configuration viam-server takes the first answer.
        return [*(each for each in own if not _is_among(each, answer)), *answer]

    # Bodies

    def _placed(
        self,
        parts: list[Part],
        answers: list[list[Geometry]],
        ends: Mapping[str, SE3],
        links: Mapping[str, Mapping[str, SE3]],
    ) -> tuple[Body, ...]:
        tree, cell = self._tree, (self._arm, *self._mates)
        bodies: list[Body] = []
        for part, geometries in zip(parts, answers, strict=True):
            holder = next((each for each in cell if tree.is_held(part.name, each)), "")
            fixed = {name: T for name, T in ends.items() if name != holder}
            seen_from = holder or f"{self._arm}_origin"
            T_seen_world = tree.T_world(seen_from, fixed).inverse
            T = T_seen_world @ tree.T_world(f"{part.name}_origin", fixed)
            for i, geometry in enumerate(geometries):
                shape, center = self._shape(part.name, i, geometry)
                name = part.name
                if geometry is not part.geometry:
                    name = _called(part.name, geometry.label, len(geometries))
                bodies.append(Body(name=name, shape=shape, T=T @ center, holder=holder))
            for link, at in links.get(part.name, {}).items():
                human, hull = link_hulls()[link]
                name = f"{part.name}:{human}"
                bodies.append(Body(name=name, shape=hull, T=T @ at, holder=holder))
        return tuple(bodies)

    def _shape(self, name: str, i: int, geometry: Geometry) -> tuple[Shape | ShapeFile, SE3]:
        """A geometry's shape and centre; the same shape object for the same message."""
        key, message = f"{name}/{i}", geometry.SerializeToString(deterministic=True)
        known = self._shapes.get(key)
        try:
            if known is None or known[0] != message:
                known = self._shapes[key] = (message, from_geometry(geometry))
            has_center = geometry.HasField("center")
            center = convert.from_pose(geometry.center) if has_center else SE3.identity()
        except ConfigError as error:
            raise SurroundingsUnknown(
                f'the geometry of "{name}" is not valid: {error}', component=name
            ) from error
        return known[1], center

    def _links_of(self, name: str) -> Mapping[str, SE3]:
        now, before = self._arms[name].T_links(), self._links.get(name)
        if before is None or not all(nearly(now[link], before[link]) for link in now):
            before = self._links[name] = now
            self._changes += 1
        return before


def _machine() -> RobotClient:
    machine = machine_here()
    assert machine is not None, "is_asked"
    return machine


@contextmanager
def _needed(what: str, name: str) -> Iterator[None]:
    """Refuse to plan if the machine refuses to answer."""
    try:
        yield
    except GRPCError as error:
        raise SurroundingsUnknown(f"{what}: {error.message or ''}", component=name) from error


async def _components(machine: RobotClient) -> list[ResourceStatus]:
    try:
        status = await machine.get_machine_status()
    except GRPCError as error:
        if error.status is Status.UNIMPLEMENTED:  # an older viam-server
            return []
        raise
    return [each for each in status.resources if each.name.type == "component"]


async def _listed(machine: RobotClient) -> list[FrameSystemConfig]:
    """The frame system by name: viam-server lists it in another order each time."""
    configs = await machine.get_frame_system_config()
    return sorted(configs, key=lambda each: each.frame.reference_frame)


async def _all(asked: Iterable[Coroutine[Any, Any, Answer]]) -> list[Answer]:
    tasks = [asyncio.ensure_future(each) for each in asked]
    try:
        return await asyncio.gather(*tasks)
    finally:
        for task in tasks:
            task.cancel()


def _called(component: str, label: str, count: int) -> str:
    """The name of a geometry in messages: its component's, with its label if there are several."""
    label = clipped(label.removeprefix(f"{component}:"), 80)
    return component if count == 1 or label in ("", component) else f"{component}:{label}"


async def _ask(name: str) -> list[Geometry]:
    """What a component answers to ``GetGeometries``."""
    machine = _machine()
    resource = _resource(machine.resource_names, name)
    if resource is None:
        await machine.refresh()  # type: ignore[no-untyped-call]  # the SDK's
        resource = _resource(machine.resource_names, name)
    if resource is None and name.endswith(REMOTE):
        return []
    if resource is None:
        reason = f'"{name}" has a frame but does not run, so its shape is unknown'
        raise SurroundingsUnknown(reason, component=name)
    try:
        client = machine.get_component(resource)
    except ResourceNotFoundError:
        return []  # of an API that this SDK does not know
    with _needed(f'"{name}" does not report its geometries', name):
        try:
            return list(await client.get_geometries())
        except NotImplementedError:
            return []
        except GRPCError as error:
            message = (error.message or "").lower()
            if error.status is Status.UNIMPLEMENTED or any(w in message for w in _HAS_NONE):
                return []
            raise


def _resource(names: list[ResourceName], name: str) -> ResourceName | None:
    return next((each for each in names if (each.type, each.name) == ("component", name)), None)


def _is_among(geometry: Geometry, others: Iterable[Geometry]) -> bool:
    bare = Geometry()
    for each in others:
        bare.CopyFrom(each)
        bare.label = geometry.label
        if bare == geometry:
            return True
    return False
