"""The World tab: widgets and handles for the obstacles around the arm; an edit moves no arm."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import viser

from so101_motion.common.errors import So101Error
from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.scene import (
    FLOOR_Z,
    Attached,
    Box,
    Capsule,
    Cylinder,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
)

from ..page import markup, texts, units
from ..page.page_context import PageContext, Part
from ..page.screen_state import Sentence, Tone
from ..page.shared_fields import SharedField, UndoButtons, grey, put
from ..scene.scene_edits import NEW_SHAPES, Thing, holder_of, pose_of
from ..scene.scene_view import SceneView
from .loaded_files import ENDINGS
from .scene_user import SceneUser
from .world_model import OverlapCheck, WorldModel, in_each_other

_GIZMO = "/world-handles"

_MOVED = 1e-4  # turns of a joint below this do not redraw what it carries [rad]; chosen

_TURNED = 0.01
"""Turns of a joint below this do not repeat the overlap check [rad]; chosen: a real arm at rest
flickers by a tick or two."""

_LOOSE, _HELD = ("attach to gripper", "delete"), ("detach", "delete")
"""Buttons for a thing; a keep-out zone says why it cannot be attached."""

_SAME = 1e-5

_FOR_VIAM = (
    "The world_state of a Move request, in the frame of an arm named “{arm}”; put your arm's name"
    " there. The floor is not included."
)


class WorldPart(Part):
    """Add, drag, resize, name, delete, attach, save and load things.

    ``on_handles`` is called with whether a thing is selected, when that changes.
    """

    def __init__(
        self,
        context: PageContext,
        user: SceneUser,
        *,
        file: Path,
        now: Callable[[], float],
        on_handles: Callable[[bool], None] = lambda _shown: None,
    ) -> None:
        self._context, self._user = context.reporting(self._report), user
        self._known: Scene = user.scene
        self.world = WorldModel(self._known, file=file, write=user.write, now=now)
        self._contacts = {name: OverlapCheck() for name in user.arms}
        self._inside: Sentence | None = None
        self._checked: tuple[Scene, Array] | None = None
        self._q = self._q_all()
        self._tools = user.tools()
        self._view = SceneView(context.server.scene, on_pick=self._pickable)
        self._gizmo = context.server.scene.add_transform_controls(
            _GIZMO, scale=0.09, depth_test=False, visible=False
        )
        self._gizmo_at = SE3.identity()
        self._on_handles = on_handles
        self._handled: str | None = None
        self._context.on_drag(self._gizmo, self._dragged, self.world.drop)
        with context.tabs.add_tab("World"):
            self._add_widgets(context.gui)

    # Widgets

    def _add_widgets(self, gui: viser.GuiApi) -> None:
        context, world = self._context, self.world
        self._sentence = gui.add_html("")
        context.buttons("Add", {kind: partial(self._add, kind) for kind in NEW_SHAPES})
        self._edits = UndoButtons(context, world.history, world.saved_files)
        self._list = gui.add_dropdown("Selected", (_nothing(()),))
        self._selected = self._field(self._list, self._choose)
        self._acts = gui.add_button_group("Change", _LOOSE, hint="What is attached moves along")
        context.on_choice(self._acts, self._act)
        self._gripper = gui.add_dropdown(
            "Gripper of",
            tuple(self._tools),
            hint="Which arm holds it",
            visible=len(self._tools) > 1,
        )
        self._add_thing(gui)
        gui.add_divider()
        self._floor = self._field(
            gui.add_checkbox("Floor", initial_value=True),
            lambda on: world.set_floor(self._floor_z if on else None),
        )
        height = gui.add_number("Floor height (mm)", 0.0, step=0.1)
        self._height = self._field(height, world.set_floor, units.MM)
        self._floor_z = FLOOR_Z
        gui.add_divider()
        self._add_files(gui)

    def _add_thing(self, gui: viser.GuiApi) -> None:
        world = self.world
        self._name = self._field(gui.add_text("Name", ""), world.rename)
        size = gui.add_vector3("Size (mm)", (1.0, 1.0, 1.0), step=1.0)
        self._size = self._field(size, lambda size: world.resize(size=size), units.MM)
        radius = gui.add_number("Radius (mm)", 1.0, step=1.0)
        self._radius = self._field(radius, lambda radius: world.resize(radius=radius), units.MM)
        length = gui.add_number("Length (mm)", 1.0, step=1.0)
        self._length = self._field(length, lambda length: world.resize(length=length), units.MM)
        self._at = gui.add_vector3("Position (mm)", (0.0, 0.0, 0.0), step=1.0)
        self._position = self._field(self._at, world.move_to, units.MM)
        turn = gui.add_vector3("Turn (°)", (0.0, 0.0, 0.0), step=1.0)
        self._turn = self._field(turn, world.turn_to, units.DEGREES)
        for box in (size, self._at, turn):
            box.precision = 1
        mass = gui.add_number("Mass (g)", 0.0, step=1.0, hint="What has a mass can be gripped")
        self._mass = self._field(mass, world.set_mass, units.GRAMS)
        zone = gui.add_checkbox("Keep-out zone", initial_value=False)
        self._zone = self._field(zone, world.set_keep_out)

    def _add_files(self, gui: viser.GuiApi) -> None:
        is_for_viam = self._user.viam_name is not None
        does = {"save": self.world.save, "download": lambda: None}  # a browser gets a download
        self._files = self._context.buttons(
            "Scene file",
            {**does, "for Viam": self._show_for_viam} if is_for_viam else does,
            "so101 plan --scene reads what save writes; for Viam: a WorldState to copy"
            if is_for_viam
            else "so101 view --cell reads what save writes; download is the scene alone",
        )
        self._context.on_asked(self._files, self._download)
        self._for_viam = gui.add_html("", visible=False)
        self._viam_scene: Scene | None = None
        bring = gui.add_upload_button(
            "Load",
            color="gray",
            icon=viser.Icon.UPLOAD,
            hint="A scene (.json), a mesh (.stl, .ply, .obj in mm; .glb),"
            " or points in m (.ply, .pcd, .xyz)",
            mime_type=",".join(ENDINGS),
        )
        with gui.add_folder("Scale and cube size", expand_by_default=False):
            hint = "Factor for the lengths in the next file: 1000 for an STL file in metres"
            scale = gui.add_number("Scale", 1.0, min=1e-6, max=1e6, hint=hint)
            hint = "For point clouds only: smaller cubes show more, and plans take longer"
            voxel = gui.add_number("Cube size (mm)", 10.0, min=1.0, max=100.0, step=1.0, hint=hint)
            gui.add_html(markup.small("Loaded points become cubes with edges of this length."))
        self._scale = self._field(scale, partial(setattr, self.world, "scale"))
        self._voxel = self._field(voxel, self.world.set_voxel, units.MM)
        bring.on_upload(
            self._context.handler(lambda event: partial(self._load, event.target.value))
        )

    def _field(
        self, widget: Any, command: Callable[[Any], None], unit: units.Unit = units.PLAIN
    ) -> SharedField:
        return SharedField(widget, command, self._context, unit)

    # Commands

    def _add(self, kind: str) -> None:
        held = self.world.scene.attached
        self.world.add(kind, [(self._T_of(each) @ pose_of(each)).p for each in held])

    def _load(self, file: viser.UploadedFile) -> None:
        self.world.load(file.name, file.content)

    def _report(self, error: So101Error) -> None:
        self.world.sentence = texts.ended(error)

    def _act(self, name: str) -> None:
        world, tools = self.world, self._user.tools()
        if name == _LOOSE[0]:
            holder = self._gripper.value
            world.hold(tools[holder], holder)
        elif name == "detach":
            world.let_go(tools[holder_of(world.thing)])
        elif name == "delete":
            world.remove()

    def _show_for_viam(self) -> None:
        """Show the scene as a Viam WorldState, until it changes or the button is pressed again."""
        world, arm = self.world, self._user.viam_name
        if arm is None or self._viam_scene is world.scene:
            self._viam_scene = None
            return
        self._viam_scene = world.scene
        self._for_viam.content = markup.to_copy(_FOR_VIAM.format(arm=arm), world.for_viam(arm=arm))

    def _download(self, client: viser.ClientHandle) -> None:
        if self._files.value == "download":
            client.send_file_download("scene.json", self.world.as_file(), save_immediately=True)

    def _pickable(self, node: Any, name: str) -> None:
        def pick() -> None:
            self.world.select(None if self.world.selected == name else name)

        self._context.on_press(node, pick)

    def _choose(self, name: str) -> None:
        self.world.select(None if name == _nothing(self.world.names) else name)

    def _dragged(self, handle: viser.TransformControlsHandle) -> None:
        self._gizmo_at = SE3.from_quaternion(handle.wxyz, handle.position)
        self.world.drag(self._gizmo_at, self._T_of(self.world.thing))

    # The page

    def refresh(self) -> bool:
        adopted = self._user.scene is not self._known
        if adopted:
            self._known = self._user.scene
            self.world.adopt(self._known)
        due = self.world.due(time.monotonic())
        refused = due is not None and not self._pass_on(due)
        q = self._q_all()
        moved = float(np.max(np.abs(q - self._q))) > _MOVED
        if moved:
            self._q, self._tools = q, self._user.tools()
        inside = self._inside
        if self._is_stale(q):
            self._checked = self._known, q
            inside = self._overlap()
        changed, self._inside = inside != self._inside, inside
        return adopted or refused or changed or (moved and bool(self.world.scene.attached))

    def _pass_on(self, scene: Scene) -> bool:
        """Have ``scene`` planned with; returns whether that is possible."""
        try:
            self._user.use(scene)
        except So101Error as error:
            self.world.refuse(error)
            return False
        self._known = self._user.scene
        return True

    def _q_all(self) -> Array:
        """Where all arms are, a row for each, [rad]."""
        return np.array([arm.state.q for arm in self._user.arms.values()])

    def _T_of(self, thing: Thing | None) -> SE3:
        return self._tools[holder_of(thing)] if isinstance(thing, Attached) else SE3.identity()

    def _overlap(self) -> Sentence | None:
        for name, arm in self._user.arms.items():
            pair = self._contacts[name].overlap(arm.scene, arm.state.q, arm.state.q_jaw)
            if pair is not None:
                sentence = in_each_other(pair)
                return texts.named(name, sentence) if name else sentence
        return None

    def _is_stale(self, q: Array) -> bool:
        """Whether to repeat the overlap check; not while anything moves."""
        if self.world.dragging or any(arm.state.arm_moving for arm in self._user.arms.values()):
            return False
        if self._checked is None or self._checked[0] is not self._known:
            return True
        return bool(np.max(np.abs(q - self._checked[1])) > _TURNED)

    def show(self) -> None:
        world = self.world
        self._view.show(world.scene, self._tools, chosen=world.selected)
        sentence = world.sentence
        if self._inside is not None and sentence.tone is not Tone.BAD:
            sentence = self._inside
        self._sentence.content = markup.sentence(sentence)
        names, nothing = world.names, _nothing(world.names)
        if self._list.options != (nothing, *names):
            self._list.options = (nothing, *names)
        self._selected.show(world.selected or nothing)
        floor_z = world.scene.floor_z
        self._floor.show(floor_z is not None)
        self._floor_z = self._floor_z if floor_z is None else floor_z
        self._height.offer(floor_z)
        self._for_viam.visible = self._viam_scene is world.scene
        if world.selected != self._handled:
            self._handled = world.selected
            self._on_handles(self._handled is not None)
        self._show_thing(world.thing)

    def _show_thing(self, thing: Thing | None) -> None:
        shape, is_held = None if thing is None else thing.shape, isinstance(thing, Attached)
        pose = None if thing is None else pose_of(thing)
        turns = pose is not None and not isinstance(shape, Sphere)
        self._name.show(None if thing is None else thing.name)
        self._size.show(shape.size if isinstance(shape, Box) else None)
        self._radius.show(shape.radius if isinstance(shape, Sphere | Capsule | Cylinder) else None)
        self._length.show(shape.length if isinstance(shape, Capsule | Cylinder) else None)
        self._at.label = "Position in gripper (mm)" if is_held else "Position (mm)"
        self._position.show(None if pose is None else pose.p)
        self._turn.show(pose.rpy if pose is not None and turns else None)
        self._scale.show(self.world.scale)
        self._voxel.show(shape.resolution if isinstance(shape, PointCloud) else self.world.voxel)
        is_zone = isinstance(thing, Obstacle) and thing.keep_out
        self._mass.show(None if thing is None or is_zone else thing.mass or 0.0)
        self._zone.show(thing.keep_out if isinstance(thing, Obstacle) else None)
        acts = _HELD if is_held else _LOOSE
        self._gripper.disabled = thing is None or is_held
        if is_held:
            put(self._gripper, holder_of(thing))
        if acts != self._acts.options:
            self._acts.options = acts
        grey(self._acts, thing is None)
        self._edits.show()
        self._gizmo.visible, self._gizmo.disable_rotations = pose is not None, not turns
        if pose is not None and not self.world.dragging:
            pose = self._T_of(thing) @ pose
            if not np.allclose(pose.matrix, self._gizmo_at.matrix, rtol=0.0, atol=_SAME):
                self._gizmo_at = pose
                self._gizmo.wxyz, self._gizmo.position = pose.quaternion_wxyz(), pose.p


def _nothing(names: tuple[str, ...]) -> str:
    """The list's entry for no selection; never the name of a thing."""
    word = "–"
    while word in names:
        word += "–"
    return word
