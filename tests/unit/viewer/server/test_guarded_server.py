import asyncio
import http.client
import logging
import socket
import threading
from urllib.parse import parse_qs, urlsplit

import msgspec
import pytest
import viser
import websockets.asyncio.server
from harness.raw_window import CAMERA
from so101_viewer.server import guarded_server
from so101_viewer.server.guarded_server import GuardError, start_guarded
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from so101_motion.common.errors import ConfigError

PROTOCOL = f"viser-v{viser.__version__}"


@pytest.fixture(scope="module")
def server():
    server = start_guarded(port=0, label="test")
    yield server
    server.close()


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
