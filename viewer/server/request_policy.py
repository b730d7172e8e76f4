"""Decide from the headers of a request who may talk to the page.

It stops three attacks: a page in the same browser opens a websocket to us (its ``Origin`` shows
it); a page rebinds its own name to 127.0.0.1 (its ``Host`` shows it); another user or machine
connects (it has no key). The key is 32 random bytes; see ``kept_key.py`` for how long it is valid.
It reaches the browser once, in the printed link, and becomes a cookie that scripts cannot read and
other sites cannot send.
"""

from __future__ import annotations

import hmac
import http.client
import ipaddress
import secrets
from dataclasses import dataclass, field
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from .head import front_file

_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}

POLICY = (
    "default-src 'none'; "
    "script-src 'unsafe-inline' 'unsafe-eval' blob:; "  # viser's page unpacks itself that way
    "worker-src blob:; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
    "connect-src {connect}; base-uri 'none'; form-action 'none'"
)
"""What our pages and films may load. ``connect-src`` matters most: viser's page takes the address
of its server from a ``?websocket=`` parameter, and runs what that server sends."""

_HTML = "text/html; charset=utf-8"


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestPolicy:
    """The rules of one running server."""

    key: str  # the secret in the link
    port: int  # where the server listens
    names: frozenset[str]  # host names by which it may be called, lower case, without port
    # whether any IP address will do as a host. Needed when listening on all interfaces, and safe:
    # rebinding takes a name
    any_address: bool = False
    tickets: set[str] = field(default_factory=set)  # keys that open once, see ticket

    def ticket(self) -> str:
        """A key that works once; for a link that others may read."""
        ticket = secrets.token_urlsafe(32)
        self.tickets.add(ticket)
        return ticket

    @property
    def cookie(self) -> str:
        """Name of the cookie; all ports of a host share cookies, so it names the port."""
        return f"so101_{self.port}"

    def answer(self, request: Request) -> Response | None:
        """A refusal, the reply that sets the cookie, or None to let the request pass."""
        headers = request.headers
        host = _single(headers, "Host")
        if host is None or not self._is_ours(host):
            return _reply(403, "This name does not belong to this page.\n")
        if "Origin" in headers and _single(headers, "Origin") != f"http://{host}":
            return _reply(403, "Requests from other pages are refused.\n")
        if self._holds_cookie(headers):
            return None
        key = parse_qs(urlsplit(request.path).query).get("key", [""])[0]
        if "Upgrade" not in headers and self._admits(key):
            return self._greet()
        return _reply(401, front_file("expired.html"), content_type=_HTML)

    def _is_ours(self, host: str) -> bool:
        name, separator, port = host.lower().rpartition(":")
        if not separator or port.endswith("]"):
            name, port = host.lower(), "80"
        if port != str(self.port):
            return False
        return name in self.names or (self.any_address and _is_address(name))

    def _holds_cookie(self, headers: Headers) -> bool:
        # Parsed by hand: http.cookies gives up at the first cookie it finds odd, and other
        # programs on localhost leave odd ones.
        pairs = (
            part.strip().partition("=")
            for line in headers.get_all("Cookie")
            for part in line.split(";")
        )
        return any(name == self.cookie and self._fits(value) for name, _, value in pairs)

    def _admits(self, candidate: str) -> bool:
        if candidate in self.tickets:  # 256 random bits; comparing them tells nobody anything
            self.tickets.discard(candidate)
            return True
        return self._fits(candidate)

    def _fits(self, candidate: str) -> bool:
        # Headers may hold any bytes; those that are not ASCII come as halves of surrogate pairs.
        return hmac.compare_digest(candidate.encode("utf-8", "replace"), self.key.encode())

    def _greet(self) -> Response:
        # A page that goes on by itself, not a redirect: a redirect keeps its initiator, so a
        # strict cookie would not be sent along when the link was clicked on another site.
        page = '<!doctype html><meta http-equiv="refresh" content="0;url=/"><title>SO-101</title>'
        reply = _reply(200, page, content_type=_HTML)
        reply.headers["Set-Cookie"] = f"{self.cookie}={self.key}; HttpOnly; SameSite=Strict; Path=/"
        return reply


def harden(reply: Response, request: Request) -> Response:
    """Add security headers to a page or file, for a request that passed the policy."""
    _confine(reply, connect=f"'self' ws://{request.headers['Host']} blob: data:")
    return reply


def _confine(reply: Response, *, connect: str) -> None:
    reply.headers["Content-Security-Policy"] = (
        f"{POLICY.format(connect=connect)}; frame-ancestors 'none'"
    )
    for name, value in _HEADERS.items():
        reply.headers[name] = value


def _reply(status: int, body: str, *, content_type: str = "text/plain; charset=utf-8") -> Response:
    data = body.encode()
    headers = Headers(
        {"Content-Type": content_type, "Content-Length": str(len(data)), "Connection": "close"}
    )
    reply = Response(status, http.client.responses[status], headers, data)
    _confine(reply, connect="'none'")
    return reply


def _single(headers: Headers, name: str) -> str | None:
    values = headers.get_all(name)
    return values[0] if len(values) == 1 else None


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True
