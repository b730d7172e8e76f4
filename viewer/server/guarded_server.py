"""Start a viser server that only its owner can use.

Stock viser listens on every interface, asks nobody who they are, accepts a websocket from any web
page open in the same browser, and lets any client open a public tunnel. So every server we start:

1. listens on this machine alone unless other machines are explicitly allowed;
2. gets a socket that is bound here: a busy port is an error, where viser would take another one;
3. asks the ``RequestPolicy`` about every request, pages and websockets alike;
4. has no handlers for the messages that ask for a tunnel;
5. is tried without a key before its link is handed out, and stopped if anything opens.

viser has no hook for this, so ``websockets.asyncio.server.serve`` is replaced while its constructor
runs. The version is pinned; step 5 and the tests catch a change.
"""

from __future__ import annotations

import errno
import http.client
import ipaddress
import logging
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import rich
import viser
import websockets.asyncio.server
from viser import _messages
from websockets.http11 import Request, Response

from so101_motion.common.errors import ConfigError, So101Error

from .head import add_head
from .kept_key import KeyOf, new_key
from .request_policy import RequestPolicy, harden

_KNOCK_TIMEOUT = 10.0
"""How long the self-check waits for an answer [s]; generous, it comes within milliseconds."""

DEFAULT_PORT = 8080  # the port of a page if none is chosen and this one is free
PORTS_TRIED = 20  # how many ports are tried, counting up from that one


class GuardError(So101Error):
    """The new server let an unauthorised request in, so it was stopped again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardedServer:
    """A running viser server behind a request policy.

    Whoever has its ``url``, with the key, may move the arm.
    """

    viser: viser.ViserServer
    url: str
    policy: RequestPolicy

    def url_for_once(self) -> str:
        """A link that opens the page once and is invalid afterwards.

        For handing to a browser's process, whose arguments others on this computer can read.
        """
        return f"{self.url.partition('?')[0]}?key={self.policy.ticket()}"

    def close(self) -> None:
        """Stop serving; open pages lose the connection."""
        with _quiet():
            self.viser.stop()


def start_guarded(
    host: str = "127.0.0.1",
    port: int | None = None,
    *,
    allow_remote: bool = False,
    label: str = "",
    key_of: KeyOf = new_key,
) -> GuardedServer:
    """Start a viser server that accepts only the link it returns.

    Args:
        host: Address to listen on.
        port: Port to listen on; 0 for any free one; None for 8080 or the next free one after it.
        allow_remote: Whether ``host`` may be more than this machine's loopback.
        label: Title of the page's main panel.
        key_of: Makes the key of the page on a port; another one each time if not given.

    Raises:
        ConfigError: The host or port cannot be used, or needs ``allow_remote``.
        GuardError: The server answered a request without the key.
    """
    listener = _listen(host, port, allow_remote=allow_remote)
    address, bound_port = listener.getsockname()[:2]
    everywhere = ipaddress.ip_address(address).is_unspecified
    hostname = socket.gethostname().lower()
    name = (reached_at() or hostname) if everywhere else _bracketed(host)
    policy = RequestPolicy(
        key=key_of(bound_port),
        port=bound_port,
        names=frozenset({name, hostname, _bracketed(address), "localhost"}),
        any_address=everywhere,
    )
    with _quiet(), _served_through(policy, listener):
        server = viser.ViserServer(host=host, port=bound_port, label=label, verbose=False)
    url = f"http://{name}:{bound_port}/?key={policy.key}"
    guarded = GuardedServer(viser=server, url=url, policy=policy)
    try:
        for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
            server._websock_server.unregister_handler(message)
        loopback = "::1" if ":" in address else "127.0.0.1"
        check_locked(loopback if everywhere else address, bound_port)
    except BaseException:
        guarded.close()
        raise
    return guarded


def check_locked(address: str, port: int) -> None:
    """Request the page and a websocket without a key; ``GuardError`` unless both are refused."""
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "c28xMDEgc2VsZi1jaGVjaw==",
        "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
    }
    for headers in ({}, upgrade):
        connection = http.client.HTTPConnection(address, port, timeout=_KNOCK_TIMEOUT)
        try:
            connection.request("GET", "/", headers=headers)
            status = connection.getresponse().status
        finally:
            connection.close()
        if status != 401:
            raise GuardError(
                f"the page answered {status} instead of 401 to a request without its key, so it "
                "was stopped; check that the installed viser is the version this was made for"
            )


def _listen(host: str, port: int | None, *, allow_remote: bool) -> socket.socket:
    if port is not None and not 0 <= port <= 65535:
        raise ConfigError("port", port, "must be between 1 and 65535, or 0 for any free port")
    first, tries = (DEFAULT_PORT, PORTS_TRIED) if port is None else (port, 1)
    try:
        family, _, _, _, where = socket.getaddrinfo(host, first, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        raise ConfigError("host", host, _UNUSABLE) from error
    if not ipaddress.ip_address(str(where[0])).is_loopback and not allow_remote:
        raise ConfigError(
            "host",
            host,
            "would let other machines move the arm; use 127.0.0.1, "
            "or allow_remote (--allow-remote) if that is what you want",
        )
    both = family == socket.AF_INET6 and socket.has_dualstack_ipv6()
    candidate = first
    while True:
        at = (where[0], candidate, *where[2:])
        try:
            return socket.create_server(at, family=family, dualstack_ipv6=both)
        except OSError as error:
            if error.errno != errno.EADDRINUSE or candidate == first + tries - 1:
                raise _bind_error(error, host, candidate) from error
        candidate += 1


_UNUSABLE = "is not an address of this machine; 127.0.0.1 always works"


def _bind_error(error: OSError, host: str, port: int) -> ConfigError:
    if error.errno == errno.EADDRINUSE:
        other = port + 1 if port < 65535 else port - 1
        return ConfigError(
            "port",
            port,
            f"another program already listens on {host}:{port}; "
            f"stop it or choose another port (--web-port), for example {other}",
        )
    if error.errno == errno.EACCES:
        return ConfigError("port", port, "ports below 1024 need root; choose a higher one")
    return ConfigError("host", host, _UNUSABLE)


_patching = threading.Lock()


@contextmanager
def _served_through(policy: RequestPolicy, listener: socket.socket) -> Iterator[None]:
    """Start viser servers on ``listener``, with ``policy`` asked about each request."""
    stock = websockets.asyncio.server.serve

    def serve(
        handler: Any, _host: str, _port: int, *, process_request: Callable[..., Any], **rest: Any
    ) -> Any:
        def answer(connection: Any, request: Request) -> Response | None:
            refusal = policy.answer(request)
            if refusal is not None:
                return refusal
            reply: Response | None = process_request(connection, request)
            if reply is None:
                return None
            add_head(reply)
            return harden(reply, request)

        return stock(handler, sock=listener, process_request=answer, logger=_log, **rest)

    with _patching:
        websockets.asyncio.server.serve = serve  # type: ignore[assignment,misc]  # no other seam
        try:
            yield
        finally:
            websockets.asyncio.server.serve = stock  # type: ignore[misc]  # as it was


def reached_at() -> str | None:
    """The address at which others reach this computer; None without a network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # An address of nobody: this chooses an interface and sends nothing.
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return None
        address: str = probe.getsockname()[0]
    return address


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host.lower()


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep viser's banner and farewell off the terminal; the caller prints the link itself."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


_log = logging.getLogger(__name__)
_log.addFilter(lambda record: record.getMessage() != "opening handshake failed")
"""Broken requests of strangers are not logged; everything else that websockets reports is."""
