import gzip
import json
import os
import re
import sys

import pytest
from so101_viewer.server import head
from so101_viewer.server.kept_key import LIFETIME, key_for, new_key
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


def test_a_link_brings_the_cookie_for_this_port_out_of_reach_of_scripts_and_a_ticket_once():
    response = answered(path=KEY)
    assert response.status_code == 200
    cookie = response.headers["Set-Cookie"]
    assert cookie.startswith(f"{COOKIE};")
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert b"s3cret" not in (response.body or b"")
    policy = RequestPolicy(key="s3cret", port=8080, names=frozenset({"127.0.0.1"}))
    path = f"/?key={policy.ticket()}"
    first, second = answered(policy, path), answered(policy, path)
    assert first.status_code == 200
    assert "s3cret" in first.headers["Set-Cookie"]
    assert second.status_code == 401


def test_a_cookie_of_bytes_that_are_no_text_is_a_wrong_one():
    headers = Headers([("Host", HOST)])  # as websockets makes them of what came in
    headers.set_insecure("Cookie", b"so101_8080=\xff".decode("ascii", "surrogateescape"))
    response = DOOR.answer(Request("/", headers))
    assert response.status_code == 401
    assert b"This link is not valid" in response.body


def test_pages_and_refusals_are_confined_to_talk_to_us_or_to_nobody():
    reply = harden(Response(200, "OK", Headers()), Request("/", Headers([("Host", HOST)])))
    policy = reply.headers["Content-Security-Policy"]
    assert f"connect-src 'self' ws://{HOST} blob: data:;" in policy
    assert "frame-ancestors 'none'" in policy
    assert reply.headers["Referrer-Policy"] == "no-referrer"
    refusal = answered(host="evil.example")
    assert "connect-src 'none'" in refusal.headers["Content-Security-Policy"]


PAGE = b"<!doctype html><html><head><title>Viser</title></head><body></body></html>"
LIGHT, DARK = "#ffffff", "#242424"


def reply(body, content="text/html; charset=utf-8", **headers):
    told = Headers({"Content-Type": content, "Content-Length": str(len(body)), **headers})
    return Response(200, "OK", told, body)


def luminance(color):
    parts = [int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    r, g, b = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def contrast(color, ground):
    high, low = sorted((luminance(color), luminance(ground)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_a_page_begins_with_our_style_and_script_and_says_how_long_it_is():
    page = reply(PAGE)
    head.add_head(page)
    assert page.body.startswith(b"<!doctype html><html><head><style>")
    assert page.body.endswith(PAGE.partition(b"<head>")[2])
    assert page.headers.get_all("Content-Length") == [str(len(page.body))]


def test_a_compressed_page_stays_compressed_and_what_is_no_page_stays_unchanged():
    page = reply(gzip.compress(PAGE), **{"Content-Encoding": "gzip"})
    head.add_head(page)
    assert b"so101-stop" in gzip.decompress(page.body)
    for other in (reply(b"<head>", "image/png"), Response(404, "no", Headers(), b"<head>")):
        head.add_head(other)
        assert other.body == b"<head>"


@pytest.mark.parametrize("name", ["good", "bad", "warm", "dim", "link"])
def test_our_colours_are_legible_on_light_and_on_dark(name):
    """4.5 is what the web's accessibility guidelines ask of text."""
    light, dark = re.findall(rf"--so101-{name}: (#[0-9a-f]{{6}})", head.front().decode())
    assert contrast(light, LIGHT) >= 4.5
    assert contrast(dark, DARK) >= 4.5


ARM = "Arm on /dev/ttyACM0"


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return tmp_path / "so101_motion" / "page-keys.json"


def test_a_page_has_the_same_key_until_a_new_one_is_made_and_without_a_folder_a_new_one(
    file, tmp_path, monkeypatch
):
    key = key_for(ARM, 8080)
    assert key_for(ARM, 8080) == key
    assert len(key) == len(new_key()) >= 43
    assert len({key, key_for(ARM, 8081), key_for("Simulated arm", 8080)}) == 3
    assert key_for(ARM, 8080) == key
    new = key_for(ARM, 8080, is_new=True)
    assert new != key
    assert key_for(ARM, 8080) == new
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "file"))
    assert len(key_for(ARM, 8080)) >= 43


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such permissions")
def test_keys_that_others_could_have_read_are_not_used_again(file):
    key = key_for(ARM, 8080)
    assert file.stat().st_mode & 0o077 == 0
    os.chmod(file, 0o644)
    assert key_for(ARM, 8080) != key
    assert file.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    ("key", "age"),
    [("short", 0.0), (None, 0.0), ("ü" * 43, 0.0), ("k" * 43, LIFETIME + 60.0), ("k" * 43, -60.0)],
)
def test_a_key_that_is_old_or_no_key_is_replaced(file, key, age):
    key_for(ARM, 8080)
    content = json.loads(file.read_text())
    (entry,) = content["keys"].values()
    entry["key"], entry["made_at"] = key, int(entry["made_at"] - age)
    file.write_text(json.dumps(content))
    new = key_for(ARM, 8080)
    assert new not in (key, None)
    file.write_text("{")
    assert key_for(ARM, 8080) != new
