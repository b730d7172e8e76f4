"""What floats over the scene: a camera's picture, the plots, alerts, and a lost connection."""

from dataclasses import replace

from harness.web_camera import UPRIGHT, WIDE, WebCamera, web_camera
from so101_viewer import serve
from so101_viewer.page.screen_state import Sentence, Tone
from so101_viewer.source import Source

TABLET, LOW = (820, 1180), (1024, 700)

CUT = "area => area.scrollHeight - area.clientHeight"
"""How much of a panel has to be scrolled to [px]."""


LOST_FOR_LONG = """(address) => Promise.all(Array.from({ length: 80 }, () => new Promise((end) => {
    new WebSocket(address).onclose = end;
})))"""
"""After as many attempts as fail in a minute or so, Chromium delays each by up to five seconds."""


def test_a_camera_is_free_of_the_arm_names_are_no_markup_and_a_lost_page_says_so(
    visit, rig, monkeypatch
):
    source = Source.given(rig, "<img src=x onerror='window.PWNED=1'><b id=bold>arm</b>")
    with (
        web_camera() as camera,
        serve(
            replace(source, camera=f"{camera}/picture"), port=0, key_of=lambda _port: "k" * 43
        ) as preview,
    ):
        window = visit()
        window.open(preview.url)
        page = window.page
        window.until(lambda: window.says("<b id=bold>"))
        image = page.get_by_alt_text("The camera's picture")
        window.until(lambda: image.count() == 1)
        area = image.locator("xpath=ancestor::*[@data-scrollarea-viewport][1]")
        for size in (WIDE, UPRIGHT):
            monkeypatch.setattr(WebCamera, "size", size)
            first = image.get_attribute("src")
            window.until(lambda first=first: image.get_attribute("src") != first)
            window.comes_to(size[0], lambda: image.evaluate("image => image.naturalWidth"))
            window.comes_to(size == UPRIGHT, lambda: area.evaluate(CUT) > 0)
            window.comes_to([], window.barriers)  # a moment later, as names come
        panel = image.locator("xpath=ancestor::*[@data-floating-window][1]").bounding_box()
        plots = page.locator("[data-floating-window]").filter(has_text="Velocity")
        assert panel["y"] + panel["height"] < plots.bounding_box()["y"]
        for link in ("gripper_link", "moving_jaw_so101_v1_link"):
            assert window.place_of(f"/live/{link}")[1] < panel["y"], "the arm is at home"
        area.focus()
        page.keyboard.press("End")
        window.until(lambda: area.evaluate("area => area.scrollTop") > 0)
        window.in_front("Events")
        window.until(lambda: window.says("connected"))
        assert page.locator("#bold").count() == 0
        assert page.evaluate("window.PWNED") is None
        port = int(preview.url.split(":")[2].split("/")[0])
        assert not window.says("No connection")
    window.until(lambda: window.says("No connection: STOP does not work."))
    window.until(lambda: window.button("STOP").is_disabled())
    assert not page.locator("#so101-state b").is_visible()
    page.set_viewport_size({"width": 390, "height": 844})
    lost, picture = page.locator("#so101-lost"), page.locator("canvas").first

    def is_free():
        """Whether the sentence lies over neither Stop nor the arm."""
        said, stop, scene = (
            each.bounding_box() for each in (lost, window.button("STOP").first, picture)
        )
        below = said["y"] + said["height"]
        is_beside = said["x"] + said["width"] <= stop["x"] + 1 or (
            stop["x"] + stop["width"] <= said["x"] + 1
        )
        apart = is_beside or below <= stop["y"] + 1 or stop["y"] + stop["height"] <= said["y"] + 1
        return apart and below < scene["y"] + 0.5 * scene["height"]

    window.until(is_free)
    page.evaluate(LOST_FOR_LONG, f"ws://127.0.0.1:{port}/")
    with serve(source, port=port, key_of=lambda _port: "k" * 43):  # the same command again
        window.until(lambda: window.button("STOP").is_enabled())
        window.until(lambda: not lost.is_visible())
        window.until(lambda: page.locator("#so101-state b").is_visible())
        window.until(lambda: page.get_by_role("tab", name="Move").count() == 1)
    with serve(rig, port=port):  # another page
        window.until(lambda: window.says("Another page runs here now. Copy its new link"))
    window.leave()


def test_many_alerts_stand_above_the_picture_in_small_windows(watcher, preview):
    window, page = watcher, watcher.page
    alerts, picture = page.locator("#so101-alerts"), page.locator("#root")
    lines = alerts.locator("p")

    def overlap():
        """By how much the alerts lie over the picture [px]."""
        above, below = alerts.bounding_box(), picture.bounding_box()
        return max(above["y"] + above["height"] - below["y"], 0.0)

    hot = "Servo {} is too hot; let it cool."
    said = [Sentence(text=hot.format(k), tone=Tone.BAD) for k in range(3)]
    for size in (TABLET, LOW):
        window.resize(size)
        for count in (1, 2, 3):
            preview.bar.alert("test", said[:count])
            window.comes_to(count, lines.count)
            window.comes_to(count == 1, lambda: overlap() > 0.0)
        preview.bar.alert("test")
