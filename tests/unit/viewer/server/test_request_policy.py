import pytest
from so101_viewer.server.request_policy import RequestPolicy, harden
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

DOOR = RequestPolicy(key="s3cret", port=8080, names=frozenset({"127.0.0.1", "localhost"}))
AT_80 = RequestPolicy(key="s3cret", port=80, names=frozenset({"localhost", "[::1]"}))
ANYWHERE = RequestPolicy(key="s3cret", port=8080, names=frozenset({"workbench"}), any_address=True)
HOST, COOKIE, KEY = "127.0.0.1:8080", "so101_8080=s3cret", "/?key=s3cret"
PASSES = None


def answered(policy=DOOR, path="/", host=HOST, **headers):
    given = [("Host", each) for each in ([host] if isinstance(host, str) else host)]
    given += [(name.capitalize(), value) for name, value in headers.items()]
    return policy.answer(Request(path, Headers(given)))


@pytest.mark.parametrize(
    ("status", "asked"),
    [
        (PASSES, {"cookie": COOKIE}),
        (PASSES, {"cookie": COOKIE, "host": "localhost:8080"}),
        (PASSES, {"cookie": COOKIE, "upgrade": "websocket", "origin": f"http://{HOST}"}),
        # Other programs leave odd cookies on localhost.
        (PASSES, {"cookie": f'a={{"b":[1,2]}}; @x; {COOKIE}; =y'}),
        # On port 80 browsers leave the port out.
        (PASSES, {"policy": AT_80, "host": "localhost", "cookie": "so101_80=s3cret"}),
        (PASSES, {"policy": AT_80, "host": "[::1]", "cookie": "so101_80=s3cret"}),
        # Listening everywhere accepts addresses, but no unknown names.
        (PASSES, {"policy": ANYWHERE, "host": "192.168.7.20:8080", "cookie": COOKIE}),
        (PASSES, {"policy": ANYWHERE, "host": "[fe80::1]:8080", "cookie": COOKIE}),
        (PASSES, {"policy": ANYWHERE, "host": "workbench:8080", "cookie": COOKIE}),
        (403, {"policy": ANYWHERE, "host": "evil.example:8080", "cookie": COOKIE}),
        # Without the right key there is no entrance.
        (401, {}),
        (401, {"cookie": "so101_8080=wrong"}),
        (401, {"cookie": "so101_8080="}),
        (401, {"cookie": "so101_8081=s3cret"}),
        (401, {"cookie": "schlüssel=größe; so101_8080=sécret"}),
        (401, {"path": "/?key=wrong"}),
        (401, {"path": "/?key="}),
        (401, {"path": "/?key=s3cre"}),
        (401, {"path": "/?Key=s3cret"}),
        (401, {"path": KEY, "upgrade": "websocket"}),  # the key in an address opens no websocket
        # A page that rebinds its own name to this computer.
        (403, {"cookie": COOKIE, "host": "evil.example:8080"}),
        (403, {"cookie": COOKIE, "host": "127.0.0.1"}),
        (403, {"cookie": COOKIE, "host": "127.0.0.1:8081"}),
        (403, {"cookie": COOKIE, "host": "localhost.evil.example:8080"}),
        (403, {"cookie": COOKIE, "host": ""}),
        (403, {"cookie": COOKIE, "host": []}),
        (403, {"cookie": COOKIE, "host": [HOST, "evil.example"]}),
        # A page of another origin in the same browser.
        *(
            (403, {"cookie": COOKIE, "upgrade": "websocket", "origin": origin})
            for origin in (
                "http://evil.example", "null", f"https://{HOST}", "http://127.0.0.1:9999",
                "http://localhost:8080", f"http://{HOST}.evil.example",
            )
        ),
    ],
)  # fmt: skip
def test_only_who_has_the_key_and_asks_from_our_own_page_gets_in(status, asked):
    response = answered(**asked)
    assert (None if response is None else response.status_code) == status


def test_the_link_is_answered_with_the_cookie_for_this_port_only_and_out_of_reach_of_scripts():
    response = answered(path=KEY)
    assert response.status_code == 200
    cookie = response.headers["Set-Cookie"]
    assert cookie.startswith(f"{COOKIE};")
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert b"s3cret" not in (response.body or b"")


def test_a_cookie_of_bytes_that_are_no_text_is_a_wrong_one():
    headers = Headers([("Host", HOST)])  # as websockets makes them of what came in
    headers.set_insecure("Cookie", b"so101_8080=\xff".decode("ascii", "surrogateescape"))
    response = DOOR.answer(Request("/", headers))
    assert response.status_code == 401
    assert b"This link has expired" in response.body


def test_pages_and_refusals_are_confined_to_talk_to_us_or_to_nobody():
    reply = harden(Response(200, "OK", Headers()), Request("/", Headers([("Host", HOST)])))
    policy = reply.headers["Content-Security-Policy"]
    assert f"connect-src 'self' ws://{HOST} blob: data:;" in policy
    assert "frame-ancestors 'none'" in policy
    assert reply.headers["Referrer-Policy"] == "no-referrer"
    refusal = answered(host="evil.example")
    assert "connect-src 'none'" in refusal.headers["Content-Security-Policy"]


def test_a_ticket_opens_once_and_brings_the_cookie():
    policy = RequestPolicy(key="s3cret", port=8080, names=frozenset({"127.0.0.1"}))
    path = f"/?key={policy.ticket()}"
    first, second = answered(policy, path), answered(policy, path)
    assert first.status_code == 200
    assert "s3cret" in first.headers["Set-Cookie"]
    assert second.status_code == 401
