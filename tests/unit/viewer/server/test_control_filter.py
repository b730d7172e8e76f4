import asyncio
from unittest.mock import Mock

import numpy as np
import pytest
import pytest_asyncio
from harness.fake_parent import until
from harness.raw_window import RawWindow
from so101_viewer.server.guarded_server import start_guarded
from so101_viewer.server.host import ServedPage
from so101_viewer.server.windows import Windows

CLICK = {
    "name": "/target",
    "instance_index": None,
    "ray_origin": (0.0, 0.0, 0.0),
    "ray_direction": (0.0, 0.0, 1.0),
    "screen_pos": (0.5, 0.5),
    "modifier": None,
    "owner": "",
}


@pytest.fixture(scope="module")
def server():
    server = start_guarded(port=0, label="test")
    yield server
    server.close()


class PageUnderTest:
    """Widgets as a page has them, and what came of pressing them."""

    def __init__(self, server):
        self.told = []
        self.done = []
        self.given_up = Mock()
        self.windows = Windows(server.viser, self.told.append, self.given_up)
        gui = server.viser.gui
        self.button = gui.add_button("Execute")
        self.stop = gui.add_button("STOP")
        self.slider = gui.add_slider("Speed", 0, 100, 1, 30)
        self.plan = gui.add_command("Plan", hotkey="P")
        self.escape = gui.add_command("Stop", hotkey="escape")
        self.gizmo = server.viser.scene.add_transform_controls("/target")
        self.windows.leave_open_as_stop(self.stop, self.escape)
        self.button.on_click(self._note("execute"))
        self.stop.on_click(self._note("stop"))
        self.slider.on_update(self._note("speed"))
        self.plan.on_trigger(self._note("plan"))
        self.escape.on_trigger(self._note("escape"))
        self.gizmo.on_update(self._note("drag"))

    def _note(self, word):
        async def note(_event):
            self.done.append(word)

        return note

    async def until(self, count):
        await until(lambda: len(self.windows.all()) == count)

    async def has_done(self, *words):
        """What was sent is done by the server's own thread, in order."""
        await until(lambda: self.done == list(words))


@pytest.fixture(scope="module")
def shared(server):
    return PageUnderTest(server)


@pytest.fixture
def page(shared):
    shared.told.clear()
    shared.done.clear()
    shared.given_up.reset_mock()
    return shared


@pytest_asyncio.fixture
async def pair(page, server):
    """The window in control, and another one."""
    async with RawWindow(server.url) as first:
        await page.until(1)
        async with RawWindow(server.url) as second:
            await page.until(2)
            yield first, second
    await page.until(0)


async def test_the_window_in_control_works_everything(page, pair):
    first, _ = pair
    await first.press(page.button)
    await first.enter(page.slider, 50)
    await first.key(page.plan)
    await first.drag("/target", (0.1, 0.2, 0.3))
    await first.press(page.stop)
    await page.has_done("execute", "speed", "plan", "drag", "stop")


async def test_another_window_changes_nothing_whatever_it_sends_but_stops(page, pair):
    first, second = pair
    await first.enter(page.slider, 30)
    await first.drag("/target", (0.0, 0.0, 0.1))
    await until(lambda: "drag" in page.done)
    page.done.clear()
    await second.press(page.button)
    await second.enter(page.slider, 99)
    await second.key(page.plan)
    await second.drag("/target", (0.9, 0.9, 0.9))
    await second.send("SceneNodeClickMessage", **CLICK)
    await second.press(page.stop)
    await second.key(page.escape)
    await page.has_done("stop", "escape")
    assert page.told[-1] == "Stop pressed in window 2"
    assert page.slider.value == 30
    np.testing.assert_allclose(page.gizmo.position, (0.0, 0.0, 0.1))


async def test_another_window_takes_control_and_gives_it_up_when_it_closes(page, server):
    async with RawWindow(server.url) as first:
        await page.until(1)
        async with RawWindow(server.url) as second:
            await page.until(2)
            mine, theirs = page.windows.all()
            await first.press(theirs.take)  # another window's own button: nothing happens
            await second.press(page.button)
            await second.press(theirs.take)
            await until(lambda: page.told[-1] == "Window 2 has control")
            assert "Window 2 has control" in mine.board.content
            await second.press(page.button)
            await first.press(page.button)
            await first.press(page.stop)
            await page.has_done("execute", "stop")
        await page.until(1)
        assert "No window has control" in mine.board.content
        page.given_up.assert_called_once_with()
        await first.press(page.button)
        await page.has_done("execute", "stop", "execute")
    await page.until(0)


async def test_windows_keep_their_numbers_low_as_they_come_and_go(page, server):
    for _ in range(3):
        async with RawWindow(server.url):
            await page.until(1)
        await page.until(0)
    assert set(page.told) == {"Window 1 opened", "Window 1 closed"}


async def test_a_window_acts_before_it_has_drawn(page, server):
    async with RawWindow(server.url, draws=False) as slow:
        await page.until(1)
        await slow.press(page.button)
        await slow.press(page.stop)
        await page.has_done("execute", "stop")
        async with RawWindow(server.url) as second:
            await page.until(2)
            await second.press(page.button)
            await second.press(page.stop)
            await page.has_done("execute", "stop", "stop")
    await page.until(0)


async def test_a_page_that_closes_under_its_windows_says_nothing_of_it(recwarn):
    page = ServedPage(start_guarded(port=0, label="test"))
    page.page_context()
    page.start()
    try:
        async with RawWindow(page.url) as window, RawWindow(page.url):
            await until(lambda: len(page.windows.all()) == 2)
            await window.enter(page._front_name, "Program")
            await until(lambda: page.front.is_program)
            await asyncio.to_thread(page.close)
            await until(lambda: not page.windows.all())
    finally:
        page.close()
    assert [str(each.message) for each in recwarn] == []
