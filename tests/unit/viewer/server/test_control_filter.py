import asyncio
import http.client
import logging
import socket
import threading
from unittest.mock import Mock
from urllib.parse import parse_qs, urlsplit

import msgspec
import numpy as np
import pytest
import pytest_asyncio
import viser
import websockets.asyncio.server
from harness.fake_parent import until
from harness.raw_window import CAMERA, RawWindow
from so101_viewer.server import guarded_server
from so101_viewer.server.guarded_server import GuardError, start_guarded
from so101_viewer.server.host import ServedPage
from so101_viewer.server.windows import Windows
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from so101_motion.common.errors import ConfigError

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


# The server: who gets in, and where it listens


PROTOCOL = f"viser-v{viser.__version__}"


def port_of(server):
    return int(urlsplit(server.url).port or 0)


def cookie_of(server):
    key = parse_qs(urlsplit(server.url).query)["key"][0]
    return f"so101_{port_of(server)}={key}"


def get(server, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port_of(server), timeout=60)
    try:
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
        response.read()
        return response
    finally:
        connection.close()


async def send_as_browser(server, *messages, cookie, origin):
    """Open the websocket as a page would, send, and stay until the server has read it all."""
    headers = {} if cookie is None else {"Cookie": cookie}
    async with connect(
        f"ws://127.0.0.1:{port_of(server)}/",
        subprotocols=[PROTOCOL],
        origin=origin,
        additional_headers=headers,
        max_size=None,
    ) as connection:
        await connection.recv()
        for message in messages:
            await connection.send(msgspec.msgpack.encode(message))
        await (await connection.ping())


def test_the_page_opens_with_a_cookie_of_32_random_bytes_and_only_with_it(server):
    link = urlsplit(server.url)
    assert link.hostname == "127.0.0.1"
    assert len(parse_qs(link.query)["key"][0]) == 43  # base64 of 32 bytes
    assert get(server).status == 401
    greeting = get(server, f"/?{link.query}")
    assert greeting.status == 200
    cookie = (greeting.getheader("Set-Cookie") or "").split(";")[0]
    page = get(server, Cookie=cookie)
    assert page.status == 200
    assert "connect-src 'self'" in (page.getheader("Content-Security-Policy") or "")


@pytest.mark.parametrize(
    ("origin", "with_cookie", "status"),
    [("http://evil.example", True, 403), ("null", True, 403), (None, False, 401)],
)
async def test_strangers_get_no_websocket(server, origin, with_cookie, status):
    cookie = cookie_of(server) if with_cookie else None
    with pytest.raises(InvalidStatus) as refusal:
        await send_as_browser(server, cookie=cookie, origin=origin)
    assert refusal.value.response.status_code == status


async def test_the_owner_gets_the_websocket_and_a_share_request_opens_no_tunnel(server):
    pressed = threading.Event()
    button = server.viser.gui.add_button("Press")
    button.on_click(lambda _event: pressed.set())
    await send_as_browser(
        server,
        {"type": "ViewerCameraMessage", **vars(CAMERA)},
        {"type": "ShareUrlRequest"},
        {"type": "GuiUpdateMessage", "uuid": button._impl.uuid, "updates": {"value": True}},
        cookie=cookie_of(server),
        origin=f"http://127.0.0.1:{port_of(server)}",
    )
    assert await asyncio.to_thread(pressed.wait, 5.0)  # so the share request before was read
    assert server.viser._share_tunnel is None
    button.remove()


def test_when_other_machines_are_allowed_the_key_is_still_demanded():
    server = start_guarded("0.0.0.0", 0, allow_remote=True)
    try:
        host = urlsplit(server.url).hostname
        assert host == (guarded_server.reached_at() or socket.gethostname().lower())
        assert host != "0.0.0.0"
        assert get(server).status == 401
        assert get(server, Cookie=cookie_of(server)).status == 200
    finally:
        server.close()


@pytest.mark.parametrize(
    ("host", "port", "allow_remote", "says"),
    [
        ("0.0.0.0", 0, False, "would let other machines move the arm"),
        ("192.0.2.7", 0, True, "is not an address of this machine"),
        ("no such host", 0, True, "is not an address of this machine"),
        ("127.0.0.1", 99999, False, "between 1 and 65535"),
    ],
)
def test_a_place_that_cannot_be_served_at_is_an_error_at_once(host, port, allow_remote, says):
    with pytest.raises(ConfigError, match=says):
        start_guarded(host, port, allow_remote=allow_remote)


def test_if_websockets_did_not_ask_the_policy_the_server_refuses_to_run(monkeypatch):
    stock = websockets.asyncio.server.serve

    def another_version(*args, process_request, **rest):
        return stock(*args, **rest)

    monkeypatch.setattr(websockets.asyncio.server, "serve", another_version)
    with pytest.raises(GuardError):
        start_guarded(port=0)


def test_a_broken_request_leaves_no_traceback(server, caplog):
    with (
        caplog.at_level(logging.WARNING),
        socket.create_connection(("127.0.0.1", port_of(server))) as link,
    ):
        link.sendall(b"\x16\x03\x01 not http\r\n\r\n")
        link.recv(1000)
    assert caplog.records == []
