"""Set up camera and lights, and the buttons over the picture that turn the camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser

from so101_motion.common.geometry import SE3, Array

MIDDLE = np.array([0.17, -0.02, 0.05])
"""The middle of the workspace of an arm [m], seen from its base."""

_CAMERA = np.array([0.61, -1.12, 0.57])
_WIDE = 1.0
"""By how much the arms must be spread for the camera to stand twice as far away [m]; chosen."""

_FIELD_OF_VIEW = math.radians(36.0)
"""Chosen: the whole workspace in the picture, the arm a little above the middle."""

_VIEWS = {
    "Home": _CAMERA,
    "Top": np.array([-0.001, 0.0, 1.40]),
    "Front": np.array([1.33, 0.0, 0.07]),
    "Side": np.array([0.0, -1.43, 0.07]),
}
"""Where the camera stands for each of the buttons over the picture, seen from the middle of one
arm's workspace, which it looks at [m]. Chosen."""

_GROUND, _KEY_LIGHT = (160, 160, 160), (0.6, -1.0, 0.5)
"""Chosen by comparing pictures with those in viser's ``studio`` surroundings."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """What the camera shows."""

    middle: Array  # what it looks at, shape (3,), [m]
    size: float = 1.0  # how large that is, as a multiple of one arm's workspace

    @classmethod
    def of_arms(cls, bases: Sequence[SE3]) -> Sight:
        middles = np.array([T @ MIDDLE for T in bases])
        ends = np.array([T.p for T in bases])
        spread = float(np.linalg.norm(np.ptp(np.concatenate([middles, ends]), axis=0)))
        own = float(np.linalg.norm(MIDDLE))
        return cls(middle=middles.mean(axis=0), size=1.0 + max(spread - own, 0.0) / _WIDE)

    def at(self, p: Array) -> Array:
        """Where the camera stands, shape (3,), [m], that stands at ``p`` for a single arm."""
        return self.middle + self.size * p


def set_up_view(server: viser.ViserServer, sight: Sight) -> None:
    """Set up camera and lights.

    A sky and a light over the viewer's left shoulder stand in for viser's surroundings, which every
    browser would have to filter before its first picture: without a GPU that takes seconds of all
    cores, and the page hears no click meanwhile.
    """
    _set_up(server, sight)
    scene = server.scene
    scene.configure_environment_map(None)
    scene.add_light_hemisphere(
        "/sky", ground_color=_GROUND, intensity=1.4, position=(0.0, 0.0, 1.0)
    )
    scene.add_light_directional("/key", intensity=1.6, position=_KEY_LIGHT)


def view_buttons(
    server: viser.ViserServer, sight: Sight
) -> tuple[tuple[str, viser.GuiButtonHandle], ...]:
    """The buttons over the picture, which turn the camera of the window they are pressed in."""
    return tuple((label, _turns(server, label, sight.at(p), sight)) for label, p in _VIEWS.items())


def _turns(
    server: viser.ViserServer, label: str, position: Array, sight: Sight
) -> viser.GuiButtonHandle:
    button = server.gui.add_button(label, visible=False)

    async def look(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client is not None:
            with event.client.atomic():
                event.client.camera.position = position
                event.client.camera.look_at = sight.middle

    button.on_click(look)
    return button


def set_up_recording(server: viser.ViserServer, sight: Sight) -> None:
    """Set up camera and lights of a recording, whose player resets them in each round."""
    _set_up(server, sight)
    server.scene.add_light_ambient("/light", intensity=0.8)


def _set_up(server: viser.ViserServer, sight: Sight) -> None:
    server.scene.set_up_direction("+z")
    server.initial_camera.position = sight.at(_CAMERA)
    server.initial_camera.look_at = sight.middle
    server.initial_camera.fov = _FIELD_OF_VIEW
    server.scene.configure_default_lights(cast_shadow=True)
