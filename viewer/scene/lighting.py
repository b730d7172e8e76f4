"""Set up camera and lights, for the page and for a recording."""

from __future__ import annotations

import math

import numpy as np
import viser

from so101_motion.common.geometry import Array

_CAMERA = (0.78, -1.14, 0.62)
_LOOK_AT = (0.17, -0.02, 0.05)
_FIELD_OF_VIEW = math.radians(36.0)
"""Chosen: the whole workspace in the picture, the arm a little above the middle."""


_VIEWS = {
    "Home": _CAMERA,
    "Top": (0.169, -0.02, 1.45),
    "Front": (1.5, -0.02, 0.12),
    "Side": (0.17, -1.45, 0.12),
}
"""Where the camera stands for each of the buttons over the picture, [m]; all look at the middle of
the workspace. Chosen."""


_FOLLOW = "Follow"
_BEHIND_TOOL = np.array([0.25, -0.40, 0.22])
"""Where the camera stands that goes along with the tool, seen from it [m]; chosen."""

_TALL_CAMERA = (0.93, -1.42, 0.56)
_TALL_LOOK_AT = (0.17, -0.02, -0.15)
"""On a phone held upright, where the panels cover the lower part of the picture."""

_GROUND, _KEY_LIGHT = (160, 160, 160), (0.6, -1.0, 0.5)
"""Chosen by comparing pictures with those in viser's ``studio`` surroundings."""

_TALL = 0.7
"""A picture is tall if its width is less than this share of its height."""


def set_up_view(server: viser.ViserServer) -> None:
    """Set up camera and lights.

    A sky and a light over the viewer's left shoulder stand in for viser's surroundings, which every
    browser would have to filter before its first picture: without a GPU that takes seconds of all
    cores, and the page hears no click meanwhile.
    """
    _set_up(server)
    server.on_client_connect(_step_back_if_tall)
    scene = server.scene
    scene.configure_environment_map(None)
    scene.add_light_hemisphere(
        "/sky", ground_color=_GROUND, intensity=1.4, position=(0.0, 0.0, 1.0)
    )
    scene.add_light_directional("/key", intensity=1.6, position=_KEY_LIGHT)


class Views:
    """The buttons over the picture, which turn the camera of the window they are pressed in.

    Attributes:
        buttons: Their labels and invisible widgets.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._following: set[int] = set()  # windows whose camera goes along with the tool
        self._p_tool: Array | None = None
        buttons = [(label, self._turns(label, p)) for label, p in _VIEWS.items()]
        follow = server.gui.add_button(_FOLLOW, visible=False)
        follow.on_click(self._follow)
        self.buttons = (*buttons, (_FOLLOW, follow))

    def moved(self, p_tool: Array) -> None:
        """Take the cameras along with the tool, at ``p_tool``, shape (3,), [m]."""
        before, self._p_tool = self._p_tool, p_tool
        if not self._following or before is None or np.allclose(before, p_tool, atol=1e-4):
            return
        for number, client in self._server.get_clients().items():
            if number in self._following:
                with client.atomic():
                    look_at = client.camera.look_at + (p_tool - before)
                    client.camera.position = client.camera.position + (p_tool - before)
                    client.camera.look_at = look_at

    async def _follow(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client is None or self._p_tool is None:
            return
        self._following.add(event.client.client_id)
        with event.client.atomic():
            event.client.camera.position = self._p_tool + _BEHIND_TOOL
            event.client.camera.look_at = self._p_tool

    def _turns(self, label: str, p: tuple[float, float, float]) -> viser.GuiButtonHandle:
        button = self._server.gui.add_button(label, visible=False)

        async def look(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client is not None:
                self._following.discard(event.client.client_id)
                with event.client.atomic():
                    event.client.camera.position = p
                    event.client.camera.look_at = _LOOK_AT

        button.on_click(look)
        return button


def set_up_recording(server: viser.ViserServer) -> None:
    """Set up camera and lights of a recording, whose player resets them in each round."""
    _set_up(server)
    server.scene.add_light_ambient("/light", intensity=0.8)


async def _step_back_if_tall(client: viser.ClientHandle) -> None:
    """Move the camera back on a phone, also after viser resets it."""

    async def look(camera: viser.CameraHandle) -> None:
        if camera.aspect < _TALL and np.allclose(camera.position, _CAMERA):
            with client.atomic():
                camera.position = _TALL_CAMERA  # takes along what is looked at, so that is next
                camera.look_at = _TALL_LOOK_AT

    client.camera.on_update(look)


def _set_up(server: viser.ViserServer) -> None:
    server.scene.set_up_direction("+z")
    server.initial_camera.position = _CAMERA
    server.initial_camera.look_at = _LOOK_AT
    server.initial_camera.fov = _FIELD_OF_VIEW
    server.scene.configure_default_lights(cast_shadow=True)
