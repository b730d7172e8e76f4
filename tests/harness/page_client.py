"""The page of this process, pressed and read without a browser: quick, but nothing is drawn.

viser keeps all widgets on the server: a test reads them there and calls what a press in the browser
would call. What a browser draws is tested in ``tests/browser``.
"""

import contextlib
import html
import re
import time

import pytest
import viser


class Hand:
    """Presses the buttons of a page and reads its texts."""

    def __init__(self, server):
        self._gui = server.gui

    def words(self):
        """What the page says, without its buttons."""
        told = (handle.content for handle in self._seen() if hasattr(handle, "content"))
        return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", text)) for text in told)

    def says(self, words):
        return words in re.sub(r"\s+", " ", self.words())

    def has(self, label):
        return any(True for _ in self._buttons(label))

    def can(self, label):
        return any(not button.disabled for button in self._buttons(label))

    def press(self, label):
        """Press a button as soon as it is enabled."""
        self.until(lambda: self.can(label), f"pressing {label!r}")
        button = next(self._buttons(label))
        for callback in button._impl.update_cb:
            with contextlib.suppress(StopIteration):  # it ends at once: it only posts a command
                callback(None).send(None)

    def expect(self, words):
        self.until(lambda: self.says(words), f"reading {words!r}")

    def until(self, condition, what, *, seconds=60.0):
        ends = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > ends:
                pytest.fail(f"{what} was not possible within {seconds:g} s: {self.words()!r}")
            time.sleep(0.05)

    def until_or(self, condition, *, seconds):
        """Wait for ``condition``, but no longer than that."""
        ends = time.monotonic() + seconds
        while not condition() and time.monotonic() < ends:
            time.sleep(0.05)

    def _buttons(self, label):
        for handle in self._seen():
            if isinstance(handle, viser.GuiButtonHandle) and handle.label == label:
                yield handle

    def _seen(self):
        containers = self._gui._container_handle_from_uuid
        for handle in [
            child for parent in list(containers.values()) for child in _children(parent)
        ]:
            if self._is_seen(handle):
                yield handle

    def _is_seen(self, handle):
        while handle is not None:
            if getattr(handle, "visible", True) is False:
                return False
            inside = getattr(handle, "_impl", None)
            uuid = getattr(inside, "parent_container_id", None)
            handle = self._gui._container_handle_from_uuid.get(uuid)
        return True


def _children(container):
    return list(getattr(container, "_children", {}).values())
