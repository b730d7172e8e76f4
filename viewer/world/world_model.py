"""State and edits of the World tab, without viser.

Each edit makes a new ``Scene``; the one before goes on the list for Undo. A drag counts as one
edit. The scene for planning is updated when a drag ends and a few times a second during it
(``due``), because each change makes planners start anew. One thread owns a ``WorldModel``; it
moves no arm.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path, PurePath

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.units import to_m
from so101_motion.files.scene_file import scene_from, scene_to, write_scene
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import (
    FLOOR,
    LINKS,
    Attached,
    Mesh,
    Obstacle,
    Scene,
    Shape,
)
from so101_motion.planning.collision.shape_files import read_mesh, read_shape, welded
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion.world_state_json import world_state_json

from ..page.screen_state import Sentence, Tone
from ..page.texts import capital
from ..scene import scene_edits
from ..scene.scene_edits import Thing

DRAG_PERIOD = 0.2
"""How often a scene that is being dragged is handed to whoever plans [s]; chosen."""

MOST_TRIANGLES = 50_000
"""A mesh with more would make pages and plans slow; chosen: ten times a simplified part."""

_MOST_PAST = 50

INVITATION = Sentence(text="Add an object, or click one to change it.")


class WorldModel:
    """The edited scene.

    Args:
        file: Where ``save`` writes.

    Attributes:
        scene: As it is now.
        selected: Name of the thing that is being edited, or None.
        sentence: What the last edit came to.
        dragging: Whether somebody holds a thing by its handles.
    """

    def __init__(self, scene: Scene, *, file: Path) -> None:
        self.scene, self.file = scene, file
        self.selected: str | None = None
        self.sentence = INVITATION
        self.dragging = False
        self._past: list[Scene] = []
        self._given, self._given_at = scene, float("-inf")

    # Looking

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all things."""
        return tuple(each.name for each in scene_edits.things(self.scene))

    @property
    def thing(self) -> Thing | None:
        """The selected thing."""
        if self.selected is None:
            return None
        return scene_edits.thing_named(self.scene, self.selected)

    @property
    def can_undo(self) -> bool:
        """Whether there is an edit to undo."""
        return bool(self._past)

    def due(self, t: float) -> Scene | None:
        """The scene to plan with from ``t`` [s] on, once for each; None when none is due."""
        if self.scene is self._given:
            return None
        if self.dragging and t - self._given_at < DRAG_PERIOD:
            return None
        self._given, self._given_at = self.scene, t
        return self.scene

    # Editing

    def select(self, name: str | None) -> None:
        """Select a thing; None for nothing."""
        self.selected = name if name in self.names else None
        self.dragging = False

    def add(self, kind: str) -> None:
        """Add a thing of ``NEW_SHAPES`` and select it."""
        self._add(scene_edits.NEW_SHAPES[kind], kind)

    def remove(self) -> None:
        """Remove the selected thing."""
        name = self._name()
        self._change(scene_edits.without(self.scene, name), f"Removed {name}.")
        self.selected = None

    def rename(self, new: str) -> None:
        """Rename the selected thing; ``ConfigError`` if the name cannot be used."""
        new = scene_edits.without_blanks(new)
        if new != self._name():
            self._change(scene_edits.renamed(self.scene, self._name(), new), "Renamed.")
            self.selected = new

    def resize(
        self,
        *,
        size: Array | None = None,
        radius: float | None = None,
        length: float | None = None,
    ) -> None:
        """Resize the selected thing: a box by its edges, shape (3,), and so on; [m]."""
        thing = scene_edits.thing_named(self.scene, self._name())
        shape = scene_edits.resized(
            read_shape(thing.shape), size=size, radius=radius, length=length
        )
        self._put(replace(thing, shape=shape), "Resized.")

    def move_to(self, p: Array) -> None:
        """Put the selected thing at a point, shape (3,), [m]; held things in the tool's frame."""
        thing = scene_edits.thing_named(self.scene, self._name())
        self._place(thing, SE3(scene_edits.pose_of(thing).R, p))

    def turn_to(self, rpy: Array) -> None:
        """Turn the selected thing to roll, pitch and yaw, shape (3,), [rad]; like ``move_to``."""
        thing = scene_edits.thing_named(self.scene, self._name())
        self._place(thing, SE3.from_rpy(rpy, scene_edits.pose_of(thing).p))

    def drag(self, T_base_thing: SE3, T_base_tool: SE3) -> None:
        """Move the selected thing to ``T_base_thing`` during a drag."""
        if self.selected is None:
            return  # it was taken away meanwhile
        thing = scene_edits.thing_named(self.scene, self.selected)
        pose = T_base_tool.inverse @ T_base_thing if isinstance(thing, Attached) else T_base_thing
        if np.allclose(pose.matrix, scene_edits.pose_of(thing).matrix, rtol=0.0, atol=1e-6):
            return  # taken hold of, not moved
        self._place(thing, pose)
        self.dragging = True

    def drop(self) -> None:
        """End the drag."""
        self.dragging = False

    def set_keep_out(self, keep_out: bool) -> None:
        """Set whether the selected obstacle is a keep-out zone."""
        thing = scene_edits.thing_named(self.scene, self._name())
        if isinstance(thing, Obstacle) and keep_out != thing.keep_out:
            text = "The arm keeps out of this zone." if keep_out else "An obstacle again."
            self._put(replace(thing, keep_out=keep_out), text)

    def set_mass(self, mass: float) -> None:
        """Set the mass of the selected held thing [kg]."""
        thing = scene_edits.thing_named(self.scene, self._name())
        if isinstance(thing, Attached):
            self._put(replace(thing, mass=mass), "Plans include its weight.")

    def set_floor(self, floor_z: float | None) -> None:
        """Set the floor's height [m], or remove the floor with None."""
        text = "No floor: the arm may go below its base." if floor_z is None else "Floor set."
        self._change(replace(self.scene, floor_z=floor_z), text)

    def hold(self, T_base_tool: SE3) -> None:
        """Attach the selected obstacle to the gripper, where it is now."""
        name = self._name()
        changed = scene_edits.held(self.scene, name, T_base_tool)
        self._change(changed, f"The gripper holds {name}; it moves along.")

    def let_go(self, T_base_tool: SE3) -> None:
        """Detach the selected thing from the gripper, where it is now."""
        name = self._name()
        self._change(scene_edits.let_go(self.scene, name, T_base_tool), f"{name} stays here.")

    def undo(self) -> None:
        """Undo the last edit."""
        if self._past:
            self.scene = self._past.pop()
            self.select(self.selected)
            self.sentence = Sentence(text="Undone.")

    # Files

    def save(self) -> None:
        """Write the scene to ``file``; ``ConfigError`` if that fails."""
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                "scene", str(self.file), f"has no folder that can be made: {error}"
            ) from error
        write_scene(self.scene, self.file)
        self.sentence = Sentence(text=f"Saved to {self.file}", tone=Tone.GOOD)

    def as_file(self) -> bytes:
        """The scene as ``so101 plan --scene`` reads it."""
        return json.dumps(scene_to(self.scene), indent=2).encode() + b"\n"

    def for_viam(self, *, arm: str) -> str:
        """The scene as the JSON of a Viam WorldState, for a machine that calls its arm ``arm``."""
        return json.dumps(world_state_json(self.scene, arm=arm), indent=1, ensure_ascii=False)

    def load(self, name: str, content: bytes) -> None:
        """Load a scene file, or add the body in a mesh file (millimetres).

        Args:
            name: What the file is called; its ending says what it is.
            content: What is in it.

        Raises:
            ConfigError: It is neither.
        """
        path = PurePath(name)
        kind = path.suffix.lower()
        if kind in (".stl", ".ply"):
            self._add(_mesh(name, kind[1:], content), path.stem)
        elif kind == ".json":
            scene = _scene(name, content)
            self._change(scene, f"Loaded {len(scene_edits.things(scene))} things.")
            self.select(self.selected)
        else:
            raise ConfigError("file", name, "must be a scene (.json) or a mesh (.stl, .ply)")

    def adopt(self, scene: Scene) -> None:
        """Use a scene that another program gave the arm; it can be undone."""
        self._change(scene, "The scene was changed elsewhere.")
        self._given = scene
        self.select(self.selected)

    # How

    def _name(self) -> str:
        if self.selected is None:
            raise ConfigError("name", None, "select an object first")
        return self.selected

    def _add(self, shape: Shape, name: str) -> None:
        scene = scene_edits.added(self.scene, shape, name=name)
        new = scene.obstacles[-1].name
        self._change(scene, f"Added {new}. Drag it by its arrows, or give numbers.")
        self.select(new)

    def _place(self, thing: Thing, pose: SE3) -> None:
        self._put(scene_edits.moved(thing, pose), "Moved.")

    def _put(self, changed: Thing, text: str) -> None:
        """Replace the selected thing by ``changed``."""
        self._change(scene_edits.with_thing(self.scene, changed), text)

    def _change(self, scene: Scene, text: str) -> None:
        if not self.dragging:
            self._past = [*self._past[1 - _MOST_PAST :], self.scene]
        self.scene = scene
        self.sentence = Sentence(text=text)


class OverlapCheck:
    """Checks whether the standing arm and the things of a scene overlap."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._collisions = CollisionModel(model, Scene())

    def overlap(self, scene: Scene, q: Array, q_jaw: float) -> tuple[str, str] | None:
        """The two bodies that overlap most, by their names; None if none do.

        The arm with itself or the floor is none of a scene's business, and what is held may stand
        on the floor.
        """
        if scene is not self._collisions.scene:
            self._collisions = CollisionModel(self._model, scene)
        own = (FLOOR, *LINKS)
        distances = self._collisions.distances(q, q_jaw)
        apart = np.array(
            [
                FLOOR in pair or all(name in own for name in pair) or distance >= 0.0
                for pair, distance in zip(self._collisions.pairs, distances, strict=True)
            ]
        )
        if np.all(apart):
            return None
        first, second = self._collisions.pairs[int(np.argmin(np.where(apart, 0.0, distances)))]
        return scene.called(first), scene.called(second)


def in_each_other(pair: tuple[str, str]) -> Sentence:
    """The sentence about two bodies that overlap."""
    first, second = pair
    return Sentence(
        text=f"{capital(f'{first} is inside {second}')} Nothing moves now; the next"
        " motion first backs out slowly, if it can.",
        tone=Tone.BAD,
    )


def _scene(name: str, content: bytes) -> Scene:
    try:
        text = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ConfigError("file", name, f"is not JSON: {error}") from error
    return scene_from(text, folder=None)  # a browser must not have files of ours read


def _mesh(name: str, kind: str, content: bytes) -> Mesh:
    """The body in a mesh file, around the middle of its bounding box."""
    try:
        vertices, triangles = welded(*read_mesh(kind, content, most=MOST_TRIANGLES))
    except ConfigError as error:
        raise ConfigError("file", name, f"({error.value}) {error.reason}") from error
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
    return Mesh(vertices=to_m(vertices - middle), triangles=triangles)
