import pytest
from so101_viewer.server.request_policy import RequestPolicy, harden
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

DOOR = RequestPolicy(key="s3cret", port=8080, names=frozenset({"127.0.0.1", "localhost"}))
COOKIE = ("Cookie", "so101_8080=s3cret")
HOST = ("Host", "127.0.0.1:8080")


def ask(*headers, path="/", policy=DOOR):
    response = policy.answer(Request(path, Headers(list(headers))))
    return None if response is None else response.status_code


def test_a_request_with_our_host_and_the_cookie_passes():
    assert ask(HOST, COOKIE) is None
    assert ask(("Host", "localhost:8080"), COOKIE) is None


def test_the_link_is_answered_with_the_cookie_for_this_port_only_and_out_of_reach_of_scripts():
    response = DOOR.answer(Request("/?key=s3cret", Headers([HOST])))
    assert response is not None
    assert response.status_code == 200
    cookie = response.headers["Set-Cookie"]
    assert cookie.startswith("so101_8080=s3cret;")
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert b"s3cret" not in (response.body or b"")


@pytest.mark.parametrize(
    "headers",
    [
        (HOST,),
        (HOST, ("Cookie", "so101_8080=wrong")),
        (HOST, ("Cookie", "so101_8080=")),
        (HOST, ("Cookie", "so101_8081=s3cret")),
        (HOST, ("Cookie", "schlüssel=größe; so101_8080=sécret")),
    ],
)
def test_without_the_right_key_there_is_no_entrance(headers):
    assert ask(*headers) == 401


def test_a_cookie_of_bytes_that_are_no_text_is_a_wrong_one():
    headers = Headers([HOST])  # as websockets makes them of what came in
    headers.set_insecure("Cookie", b"so101_8080=\xff".decode("ascii", "surrogateescape"))
    response = DOOR.answer(Request("/", headers))
    assert response is not None
    assert response.status_code == 401


@pytest.mark.parametrize("path", ["/?key=wrong", "/?key=", "/?key=s3cre", "/?Key=s3cret"])
def test_a_wrong_key_in_the_link_is_refused(path):
    assert ask(HOST, path=path) == 401


def test_the_key_in_the_address_does_not_open_a_websocket():
    assert ask(HOST, ("Upgrade", "websocket"), path="/?key=s3cret") == 401


@pytest.mark.parametrize(
    "host", ["evil.example:8080", "127.0.0.1", "127.0.0.1:8081", "localhost.evil.example:8080", ""]
)
def test_a_page_that_rebinds_its_name_is_refused_even_with_the_cookie(host):
    assert ask(("Host", host), COOKIE) == 403


def test_a_request_without_a_host_or_with_two_is_refused():
    assert ask(COOKIE) == 403
    assert ask(HOST, ("Host", "evil.example:8080"), COOKIE) == 403


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "https://127.0.0.1:8080",
        "http://127.0.0.1:9999",
        "http://localhost:8080",
        "http://127.0.0.1:8080.evil.example",
    ],
)
def test_a_foreign_origin_is_refused_even_with_the_cookie(origin):
    assert ask(HOST, COOKIE, ("Upgrade", "websocket"), ("Origin", origin)) == 403


def test_our_own_origin_passes():
    assert ask(HOST, COOKIE, ("Upgrade", "websocket"), ("Origin", "http://127.0.0.1:8080")) is None


def test_odd_cookies_of_other_programs_do_not_lock_the_owner_out():
    assert ask(HOST, ("Cookie", 'a={"b":[1,2]}; @x; so101_8080=s3cret; =y')) is None


def test_on_port_80_browsers_leave_the_port_out_of_the_host():
    policy = RequestPolicy(key="s3cret", port=80, names=frozenset({"localhost", "[::1]"}))
    cookie = ("Cookie", "so101_80=s3cret")
    assert ask(("Host", "localhost"), cookie, policy=policy) is None
    assert ask(("Host", "[::1]"), cookie, policy=policy) is None


def test_listening_everywhere_accepts_addresses_but_not_unknown_names():
    policy = RequestPolicy(
        key="s3cret", port=8080, names=frozenset({"workbench"}), any_address=True
    )
    assert ask(("Host", "192.168.7.20:8080"), COOKIE, policy=policy) is None
    assert ask(("Host", "[fe80::1]:8080"), COOKIE, policy=policy) is None
    assert ask(("Host", "workbench:8080"), COOKIE, policy=policy) is None
    assert ask(("Host", "evil.example:8080"), COOKIE, policy=policy) == 403


def test_pages_are_confined_to_talk_to_us():
    reply = harden(Response(200, "OK", Headers()), Request("/", Headers([HOST])))
    policy = reply.headers["Content-Security-Policy"]
    assert "connect-src 'self' ws://127.0.0.1:8080 blob: data:;" in policy
    assert "frame-ancestors 'none'" in policy
    assert reply.headers["Referrer-Policy"] == "no-referrer"


def test_refusals_are_confined_too():
    response = DOOR.answer(Request("/", Headers([("Host", "evil.example")])))
    assert response is not None
    assert "connect-src 'none'" in response.headers["Content-Security-Policy"]


def test_a_ticket_opens_once_and_brings_the_cookie():
    policy = RequestPolicy(key="s3cret", port=8080, names=frozenset({"127.0.0.1"}))
    path = f"/?key={policy.ticket()}"
    first = policy.answer(Request(path, Headers([HOST])))
    assert first is not None
    assert first.status_code == 200
    assert "s3cret" in first.headers["Set-Cookie"]
    second = policy.answer(Request(path, Headers([HOST])))
    assert second is not None
    assert second.status_code == 401
