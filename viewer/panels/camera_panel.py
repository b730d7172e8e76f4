"""A camera's picture over the scene."""

from __future__ import annotations

import time

import viser

from so101_motion.viam.client import MachineRig

from ..page import markup
from ..page.camera_feed import CameraFeed
from ..page.page_context import PageContext
from ..page.part import Part

OLD = 2.0
"""A picture older than this is grey, and says so [s]; chosen."""

_SIZE = (228, 225)
"""Width and height of the panel [px]; chosen: a picture of 4:3 is not cut."""

_ASIDE, _ABOVE = 12, 52
"""Distance from the right and from the lower edge of the scene [px]; chosen: over the floor, clear
of an arm at home in narrow windows too, of alerts, and of the folded plots."""


class CameraPart(Part):
    """Shows the pictures of a camera.

    Args:
        camera: Its device or address, or the machine's name of it.
        machine: The machine with cameras, if there is one.

    Raises:
        ConfigError: It is none of these.
    """

    def __init__(
        self, context: PageContext, camera: str, machine: MachineRig | None = None
    ) -> None:
        server = context.server
        self.feed = CameraFeed(
            camera,
            wanted=lambda: bool(server.get_clients()),
            ask=None if machine is None else machine.picture,
        )
        self._shown: object = None
        panel = context.gui.add_panel()
        with panel.add_tab("Camera", viser.Icon.CAMERA):
            self._html = context.gui.add_html(markup.small("No picture yet."))
        width, height = _SIZE
        panel.float(x=-_ASIDE, y=-_ABOVE, width=width, height=height)

    def refresh(self) -> bool:
        """Return whether there is a new picture, or none for a while."""
        before, self._shown = self._shown, (self.feed.picture, self._is_old(), self.feed.problem)
        return self._shown != before

    def _is_old(self) -> bool:
        picture = self.feed.picture
        return picture is None or time.monotonic() - picture.t > OLD

    def show(self) -> None:
        """Show it."""
        picture, is_old = self.feed.picture, self._is_old()
        says = "" if not is_old else self.feed.problem or "the camera sends no picture"
        self._html.content = markup.picture(None if picture is None else picture.as_url, says)

    def close(self) -> None:
        """End the fetching."""
        self.feed.close()
