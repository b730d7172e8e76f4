"""The page of this process, pressed and read without a browser: quick, but nothing is drawn.

viser keeps all widgets on the server: a test reads them there and calls what a press in the browser
would call. What a browser draws is tested in ``tests/browser``.
"""

import contextlib
import html
import re
import time
from types import SimpleNamespace

import pytest
import viser


class Hand:
    """Presses the buttons of a page and of its bar, and reads its texts."""

    def __init__(self, page):
        self._gui, self._scene, self._bar = page.gui, page._server.viser.scene, page.bar

    def words(self):
        """What the page and its bar say, without the page's buttons."""
        told = (handle.content for handle in self._seen() if hasattr(handle, "content"))
        texts = (html.unescape(re.sub(r"<[^>]+>", " ", text)) for text in told)
        return " ".join((self._bar.text(), *texts))

    def says(self, words):
        return words in re.sub(r"\s+", " ", self.words())

    def warns(self, words):
        """Whether the bar says so now."""
        return words in self._bar.text()

    def has(self, label):
        return any(True for _ in self._buttons(label))

    def can(self, label):
        return any(not button.disabled for button in self._buttons(label))

    def press(self, label):
        """Press a button as soon as it is enabled; one of the bar is not asked again."""
        self.until(lambda: self.can(label), f"pressing {label!r}")
        _call(next(self._buttons(label)), None)

    def enter(self, label, value):
        """Give a slider or field a value, as a person does."""
        (field,) = (each for each in self._seen() if getattr(each, "label", "") == label)
        field._impl.value = value
        _call(field, SimpleNamespace(client_id=1, target=field))

    def color_of(self, part):
        """The colour of the part of the scene whose name begins so."""
        nodes = dict(self._scene._handle_from_node_name)
        return tuple(next(node for name, node in nodes.items() if name.startswith(part)).color)

    def place_of(self, node):
        """Where a node of the scene is in its parent, shape (3,), [m]."""
        return self._scene._handle_from_node_name[node].position

    def expect(self, words):
        self.until(lambda: self.says(words), f"reading {words!r}")

    def until(self, condition, what="going on", *, seconds=60.0):
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
        if label == "STOP" and self._bar.stop is not None:
            yield self._bar.stop
        for each in self._bar.buttons:
            if each.label == label:
                yield SimpleNamespace(_impl=each.button._impl, disabled=each.why_not is not None)
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


def _call(widget, event):
    """Have the page note an event; a handler that only posts a command ends at once."""
    for callback in widget._impl.update_cb:
        posting = callback(event)
        if posting is not None:
            with contextlib.suppress(StopIteration):
                posting.send(None)


def _children(container):
    return list(getattr(container, "_children", {}).values())
