"""State and edits of the World tab, without viser.

Each edit makes a new ``Scene``, with undo and redo. The scene for planning is updated when a drag
ends and a few times a second during it (``due``), because planners start anew after each change.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.geometry import LARGEST, SE3, Array
from so101_motion.files.scene_file import scene_to, write_scene
from so101_motion.planning.collision.coal_shapes import distance_outside, held_shape
from so101_motion.planning.collision.collision import NEARBY, CollisionModel
from so101_motion.planning.collision.scene import (
    FLOOR,
    LINKS,
    Attached,
    Obstacle,
    PointCloud,
    Scene,
    Shape,
)
from so101_motion.planning.collision.shape_files import read_shape
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion.geometries import world_state_json

from ..page import texts
from ..page.history import History, SavedFiles
from ..page.screen_state import Sentence, Tone
from ..page.texts import capital
from ..scene import scene_edits
from ..scene.scene_edits import Thing
from .loaded_files import VOXEL, read_loaded, thinned

DRAG_PERIOD = 0.2  # how often the scene for planning is updated during a drag [s]; chosen

_BETWEEN_JAWS = 0.02  # from the tip to a thing that may be between the jaws [m]; chosen

INVITATION = Sentence("Add an object, or select one to change it.")


class WorldModel:
    """The edited scene.

    Args:
        now: The time [s]; without it each edit is undone by itself, also while somebody types.

    Attributes:
        dragging: Whether somebody holds a thing by its handles.
        voxel: Edge of the cubes of a cloud that is loaded [m].
        scale: Factor for the lengths of a mesh or cloud that is loaded.
        saved_files: Undoes ``save``.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        file: Path,
        write: Callable[[Scene, Path], None] = write_scene,
        now: Callable[[], float] | None = None,
    ) -> None:
        self.scene, self.file, self._write = scene, file, write
        self.selected: str | None = None
        self.sentence = INVITATION
        self.dragging = False
        self.voxel = VOXEL
        self.scale = 1.0
        self.saved_files = SavedFiles(
            lambda _name: self.file, lambda: (), partial(setattr, self, "sentence")
        )
        self.history = History(scene, self._return_to, now)
        self._given, self._given_at = scene, float("-inf")

    # Looking

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(each.name for each in scene_edits.things(self.scene))

    @property
    def thing(self) -> Thing | None:
        if self.selected is None:
            return None
        return scene_edits.thing_named(self.scene, self.selected)

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
        self.selected = name if name in self.names else None
        self.dragging = False

    def add(self, kind: str, held_at: Sequence[Array] = ()) -> None:
        """Add a thing of ``NEW_SHAPES``, clear of things held at some points, and select it."""
        self._add(scene_edits.NEW_SHAPES[kind], kind, held_at=held_at)

    def remove(self) -> None:
        name = self._name()
        self._change(scene_edits.without(self.scene, name), f"Removed {name}.")
        self.selected = None

    def rename(self, new: str) -> None:
        new = scene_edits.without_blanks(new)
        if new != self._name():
            self._change(scene_edits.renamed(self.scene, self._name(), new), "Renamed.", "name")
            self.selected = new

    def resize(self, **to: Any) -> None:
        """Resize the selected thing: ``size``, shape (3,), ``radius`` or ``length``, [m]."""
        for name, lengths in to.items():
            _check(name, 1000.0 * lengths, "mm")
        thing = scene_edits.thing_named(self.scene, self._name())
        shape = scene_edits.resized(read_shape(thing.shape), **to)
        self._put(scene_edits.reshaped(thing, shape), "Resized.")

    def move_to(self, p: Array) -> None:
        """Put the selected thing at a point, shape (3,), [m]; held things in the tool's frame."""
        thing = scene_edits.thing_named(self.scene, self._name())
        self._place(thing, SE3(scene_edits.pose_of(thing).R, p))

    def turn_to(self, rpy: Array) -> None:
        """Turn the selected thing to roll, pitch and yaw, shape (3,), [rad]; like ``move_to``."""
        thing = scene_edits.thing_named(self.scene, self._name())
        self._place(thing, SE3.from_rpy(rpy, scene_edits.pose_of(thing).p))

    def drag(self, T_base_thing: SE3, T_base_tool: SE3) -> None:
        if self.selected is None:
            return  # it was removed meanwhile
        thing = scene_edits.thing_named(self.scene, self.selected)
        pose = T_base_tool.inverse @ T_base_thing if isinstance(thing, Attached) else T_base_thing
        if np.allclose(pose.matrix, scene_edits.pose_of(thing).matrix, rtol=0.0, atol=1e-6):
            return  # taken hold of, not moved
        self._place(thing, pose)
        self.dragging = True

    def drop(self) -> None:
        self.dragging = False

    def set_keep_out(self, keep_out: bool) -> None:
        thing = scene_edits.thing_named(self.scene, self._name())
        if isinstance(thing, Obstacle) and keep_out != thing.keep_out:
            text = "The arm keeps out of this zone." if keep_out else "This is an obstacle again."
            mass = None if keep_out else thing.mass  # nothing that can be gripped
            self._put(replace(thing, keep_out=keep_out, mass=mass), text)

    def set_mass(self, mass: float) -> None:
        """Set the mass of the selected thing [kg]; an obstacle that has one is an item."""
        _check("mass", 1000.0 * mass, "g")
        thing = scene_edits.thing_named(self.scene, self._name())
        if isinstance(thing, Attached):
            self._put(replace(thing, mass=mass), "Plans include its weight.")
        elif mass != (thing.mass or 0.0):
            text = "The gripper can take it." if mass else "This is an obstacle again."
            self._put(replace(thing, mass=mass or None), text)

    def set_floor(self, floor_z: float | None) -> None:
        """Set the floor's height [m], or remove the floor with None."""
        text = "No floor: the arm may go below its base." if floor_z is None else "Floor set."
        self._change(replace(self.scene, floor_z=floor_z), text, "floor")

    def hold(self, T_base_tool: SE3, holder: str = "") -> None:
        name = self._name()
        changed = scene_edits.held(self.scene, name, T_base_tool, holder)
        new = changed.attached[-1]
        shape, _ = held_shape(read_shape(new.shape))
        gap = distance_outside(new.T_tool_object.inverse.p, shape)
        text = f"{holder or 'The gripper'} holds {name}; it moves along."
        if gap > _BETWEEN_JAWS:
            text += f" It is not between the jaws: the tip is {1000.0 * gap:.0f} mm away."
        self._change(changed, text)

    def let_go(self, T_base_tool: SE3) -> None:
        name = self._name()
        self._change(scene_edits.let_go(self.scene, name, T_base_tool), f"{name} stays here.")

    # Files

    def save(self) -> None:
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                "scene", str(self.file), f"has no folder that can be made: {error}"
            ) from error
        with self.saved_files.changing(self.file.name):
            self._write(self.scene, self.file)
        self.sentence = Sentence(f"Saved to {self.file}", Tone.GOOD)

    def as_file(self) -> bytes:
        """The scene as ``so101 plan --scene`` reads it, without what one of several arms holds."""
        loose = tuple(each for each in self.scene.attached if not each.holder)
        scene = replace(self.scene, attached=loose)
        return json.dumps(scene_to(scene), indent=2).encode() + b"\n"

    def for_viam(self, *, arm: str) -> str:
        """The scene as the JSON of a Viam WorldState, for a machine that calls its arm ``arm``."""
        exact = json.dumps(world_state_json(self.scene, arm=arm), ensure_ascii=False)
        rounded = json.loads(exact, parse_float=lambda number: round(float(number), 6))
        return json.dumps(rounded, indent=1, ensure_ascii=False)

    def load(self, name: str, content: bytes) -> None:
        """Load a scene, or add what is in a file of a mesh or of points; see ``read_loaded``."""
        found = read_loaded(name, content, voxel=self.voxel, scale=self.scale)
        if isinstance(found, Scene):
            loaded = len(scene_edits.things(found))
            held = (each for each in self.scene.attached if each.holder)
            found = replace(found, attached=(*found.attached, *held))
            self._change(found, f"Loaded {loaded} thing{'' if loaded == 1 else 's'}.")
            self.select(self.selected)
        elif isinstance(found, PointCloud):
            self._add(found, PurePath(name).stem, place=SE3.identity())
            count = f"{len(found.points)} cubes of {1000.0 * self.voxel:g} mm"
            self.sentence = Sentence(f"Added {self.selected}, {count}, where it was seen.")
        else:
            self._add(found, PurePath(name).stem)

    def set_voxel(self, voxel: float) -> None:
        """Set the edge of a cloud's cubes [m]: of the selected one, and of those to come."""
        thing = self.thing
        if thing is not None and isinstance(thing.shape, PointCloud):
            self._put(replace(thing, shape=thinned(thing.shape.points, voxel)), "Resized.")
        self.voxel = voxel

    def refuse(self, error: So101Error) -> None:
        """Take back an edit that cannot be planned with, and say why."""
        self.history.undo()
        self.sentence = texts.ended(error)

    def adopt(self, scene: Scene) -> None:
        """Use a scene that another program gave the arm; it can be undone."""
        self._change(scene, "Changed by a pick or by another program.")
        self._given = scene
        self.select(self.selected)

    # Helpers

    def _name(self) -> str:
        if self.selected is None:
            raise ConfigError("name", None, "select an object first")
        return self.selected

    def _add(
        self,
        shape: Shape,
        name: str,
        *,
        place: SE3 | None = None,
        held_at: Sequence[Array] = (),
    ) -> None:
        scene = scene_edits.added(self.scene, shape, name=name, place=place, held_at=held_at)
        new = scene.obstacles[-1].name
        self._change(scene, f"Added {new}. Drag it by its arrows, or give numbers.")
        self.select(new)

    def _place(self, thing: Thing, pose: SE3) -> None:
        self._put(scene_edits.moved(thing, pose), "Moved.")

    def _put(self, changed: Thing, text: str) -> None:
        self._change(scene_edits.with_thing(self.scene, changed), text, (changed.name, text))

    def _return_to(self, scene: Scene, text: str) -> None:
        self.scene = scene
        self.select(self.selected)
        self.sentence = Sentence(text)

    def _change(self, scene: Scene, text: str, kind: Hashable = None) -> None:
        if self.dragging:
            self.history.amend(scene)
        else:
            self.history.add(scene, kind)
        self.scene = scene
        self.sentence = Sentence(text)


def _check(name: str, entered: Array | float, unit: str) -> None:
    """Refuse a size or a mass that was entered in mm or g, in that unit."""
    least, most = np.min(entered), np.max(entered)
    if not 0.0 <= least <= most <= 1000.0 * LARGEST:
        wrong = least if least < 0.0 else most
        reason = f"{name} must be 0 to {1000.0 * LARGEST:.0f} {unit}, not {wrong:g} {unit}"
        raise ConfigError(name, None, reason)


class OverlapCheck:
    """Checks whether the standing arm and the things of a scene overlap."""

    _collisions: CollisionModel | None = None  # of the scene that was looked at last

    def overlap(self, scene: Scene, q: Array, q_jaw: float) -> tuple[str, str] | None:
        """The two bodies that overlap most, by their names; None if none do.

        Overlaps of the arm with itself or with the floor are not counted, and held things may stand
        on the floor.
        """
        if self._collisions is None or self._collisions.scene is not scene:
            self._collisions = CollisionModel(RobotModel.load(), scene)
        for each in self._collisions.nearest(q, q_jaw, within=NEARBY):
            pair = each.first, each.second
            if each.distance < 0.0 and FLOOR not in pair and not {*pair} <= {*LINKS}:
                return scene.called(each.first), scene.called(each.second)
        return None


def in_each_other(pair: tuple[str, str]) -> Sentence:
    first, second = pair
    return Sentence(
        f"{capital(f'{first} is inside {second}')} Nothing moves now; the next"
        " motion first backs out slowly, if it can.",
        Tone.BAD,
    )
