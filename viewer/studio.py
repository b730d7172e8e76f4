"""Camera and lights, for the page and for a recording."""

from __future__ import annotations

import math

import viser

_CAMERA = (0.78, -1.14, 0.62)
_LOOK_AT = (0.17, -0.02, 0.05)
_FIELD_OF_VIEW = math.radians(36.0)
"""Chosen: the whole workspace in the picture, the arm a little above the middle."""


def furnish(server: viser.ViserServer) -> None:
    """Set the camera up and switch the lights on."""
    _set_up(server)
    server.scene.configure_environment_map("studio", environment_intensity=0.4)


def furnish_to_record(server: viser.ViserServer) -> None:
    """The same for a recording: players take surroundings away and fade them in at each round."""
    _set_up(server)
    server.scene.add_light_ambient("/light", intensity=0.8)


def _set_up(server: viser.ViserServer) -> None:
    server.scene.set_up_direction("+z")
    server.initial_camera.position = _CAMERA
    server.initial_camera.look_at = _LOOK_AT
    server.initial_camera.fov = _FIELD_OF_VIEW
    server.scene.configure_default_lights(cast_shadow=True)
