import threading
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest
from so101_viewer.page import units
from so101_viewer.page.page_context import PageContext
from so101_viewer.page.shared_fields import SharedField
from so101_viewer.server.host import Commands


class FakeWidget:
    """Keeps what it was set to, and every time it was."""

    def __init__(self):
        self.written = []
        self._value = 0
        self._entered = None

    @property
    def value(self):
        return self._value

    @value.setter
    def value(self, value):
        self._value = value
        self.written.append(value)

    def on_update(self, handler):
        self._entered = handler

    async def enter(self, value, *, client_id=1):
        self._value = value
        assert self._entered is not None
        await self._entered(SimpleNamespace(client_id=client_id, target=self))


def make():
    widget, commands, done = FakeWidget(), deque(), []
    unused = None
    context = PageContext(server=unused, tabs=unused, workers=unused, post=commands.append)
    return widget, SharedField(widget, done.append, context, units.Unit(round)), commands, done


def test_a_field_without_a_value_stays_in_its_place_and_is_grey():
    widget, field, _, _ = make()
    for value, disabled in ((5, False), (None, True), (6, False)):
        field.offer(value)
        assert vars(widget)["disabled"] is disabled
    assert widget.written == [5, 6]


async def test_a_picture_drawn_while_somebody_types_does_not_put_the_old_value_back():
    widget, field, commands, done = make()
    field.show(5)
    await widget.enter(8)
    field.show(5)  # the page does not know of the 8 yet
    assert widget.value == 8
    commands.popleft()()
    assert done == [8]
    await widget.enter(9)
    field.show(8)  # nor of the 9
    assert widget.value == 9
    commands.popleft()()
    field.show(8)  # the page refuses it
    assert widget.value == 8
    await widget.enter(5, client_id=None)  # by the page itself, so no command
    assert not commands


@pytest.mark.parametrize(
    ("unit", "value", "shown"),
    [
        (units.DEGREES, np.radians(12.34), 12.3),
        (units.WHOLE_DEGREES, np.radians(44.6), 45),
        (units.MM, np.array([0.25, -0.00004, 0.15]), (250.0, 0.0, 150.0)),
        (units.GRAMS, 0.0204, 20.4),
        (units.PERCENT, 0.405, 40),
    ],
)
def test_a_unit_shows_a_value_and_takes_what_is_shown(unit, value, shown):
    assert unit.shown(value) == shown
    assert unit.shown(unit.meant(shown)) == shown
    np.testing.assert_allclose(unit.meant(shown), value, atol=0.01)


def test_commands_run_in_order_and_once_and_one_that_fails_is_reported():
    done, errors = [], []
    commands = Commands(errors.append)
    commands.post(lambda: done.append("dropped"))
    commands.drop()
    assert not commands.run()
    commands.post(lambda: done.append(0))
    commands.post(lambda: 1 / 0)
    commands.post(lambda: done.append(1))
    assert commands.run()
    assert not commands.run()
    assert done == [0, 1]
    assert isinstance(errors[0], ZeroDivisionError)


def test_a_drop_waits_for_the_command_under_way_and_forgets_the_rest():
    """Otherwise a move that is just being started could slip behind the stop."""
    done = []
    started, may_end = threading.Event(), threading.Event()
    commands = Commands(lambda _error: None)

    def start_a_move():
        started.set()
        assert may_end.wait(60.0)
        done.append("start")

    def stop():
        commands.drop()
        done.append("stop")

    commands.post(start_a_move)
    commands.post(lambda: done.append("never"))
    page = threading.Thread(target=commands.run)
    page.start()
    assert started.wait(60.0)
    stopping = threading.Thread(target=stop)
    stopping.start()
    may_end.set()
    page.join(60.0)
    stopping.join(60.0)
    assert done == ["start", "stop"]
