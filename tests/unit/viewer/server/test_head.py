import gzip
import re

import pytest
from so101_viewer.server import head
from websockets.datastructures import Headers
from websockets.http11 import Response

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


def test_a_compressed_page_stays_compressed():
    page = reply(gzip.compress(PAGE), **{"Content-Encoding": "gzip"})
    head.add_head(page)
    assert b"so101-stop" in gzip.decompress(page.body)


def test_responses_that_are_no_page_stay_unchanged():
    for other in (reply(b"<head>", "image/png"), Response(404, "no", Headers(), b"<head>")):
        head.add_head(other)
        assert other.body == b"<head>"


@pytest.mark.parametrize("name", ["good", "bad", "warm", "dim", "link"])
def test_our_colours_are_legible_on_light_and_on_dark(name):
    """4.5 is what the web's accessibility guidelines ask of text."""
    light, dark = re.findall(rf"--so101-{name}: (#[0-9a-f]{{6}})", head.front().decode())
    assert contrast(light, LIGHT) >= 4.5
    assert contrast(dark, DARK) >= 4.5
