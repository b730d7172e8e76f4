"""What floats over the scene: a camera's picture, the plots, and alerts."""

from dataclasses import replace

import pytest
from harness.browser_user import LAPTOP, PHONE
from harness.web_camera import web_camera
from so101_viewer import serve_source
from so101_viewer.page.screen_state import Sentence, Tone
from so101_viewer.source import Source

TABLET, LOW = (820, 1180), (1024, 700)

CUT = "area => area.scrollHeight - area.clientHeight"
"""How much of a panel has to be scrolled to [px]."""


@pytest.mark.parametrize(("picture", "is_cut"), [("picture", False), ("upright", True)])
def test_a_cameras_picture_is_free_of_the_arm_and_is_scrolled_by_keys_where_it_is_cut(
    visit, rig, picture, is_cut
):
    with web_camera() as camera:
        source = replace(Source.given(rig, "Arm"), camera=f"{camera}/{picture}")
        with serve_source(source, port=0) as preview:
            window = visit()
            window.open(preview.url)
            image = window.page.get_by_alt_text("The camera's picture")
            window.until(lambda: image.count() == 1)
            window.until(lambda: image.evaluate("image => image.naturalWidth") > 0)
            area = image.locator("xpath=ancestor::*[@data-scrollarea-viewport][1]")
            window.until(lambda: (area.evaluate(CUT) > 0) == is_cut)
            window.comes_to([], window.barriers)  # a moment later, as names come
            panel = image.locator("xpath=ancestor::*[@data-floating-window][1]").bounding_box()
            plots = window.page.locator("[data-floating-window]").filter(has_text="Velocity")
            below = plots.bounding_box()
            assert panel is not None
            assert below is not None
            assert panel["y"] + panel["height"] < below["y"]
            for link in ("gripper_link", "moving_jaw_so101_v1_link"):
                assert window.place_of(f"/live/{link}")[1] < panel["y"], "the arm is at home"
            if is_cut:
                area.focus()
                window.page.keyboard.press("End")
                window.until(lambda: area.evaluate("area => area.scrollTop") > 0)
            window.leave()


def test_many_alerts_stand_above_the_picture_in_small_windows_and_a_click_unfolds_them(
    guest, visit, preview
):
    window = visit(TABLET)
    window.open(preview.url)  # without control, which is one alert more
    page = window.page
    alerts, picture = page.locator("#so101-alerts"), page.locator("#root")
    lines = alerts.locator("p")

    def overlap():
        """By how much the alerts lie over the picture [px]."""
        above, below = alerts.bounding_box(), picture.bounding_box()
        assert above is not None
        assert below is not None
        return max(above["y"] + above["height"] - below["y"], 0.0)

    def high():
        """Which have more than one line."""
        boxes = [line.bounding_box() for line in lines.all()]
        return [box is not None and box["height"] > 40.0 for box in boxes]

    hot = "Servo {} is too hot; let it cool."
    said = [Sentence(text=hot.format(k), tone=Tone.BAD) for k in range(3)]
    for size in (TABLET, LOW):
        page.set_viewport_size({"width": size[0], "height": size[1]})
        for count in (1, 2, 3):
            preview.bar.alert("test", said[:count])
            window.comes_to(count, lines.count)
            window.comes_to(count == 1, lambda: overlap() > 0.0)
        preview.bar.alert("test")

    page.set_viewport_size({"width": LAPTOP[0], "height": LAPTOP[1]})
    said = [Sentence(text=6 * hot.format(k), tone=Tone.BAD) for k in range(4)]
    preview.bar.alert("test", said[:2])
    window.comes_to([True, True], high)
    preview.bar.alert("test", said)
    window.comes_to([True, False, False, False], high)
    for is_open in (True, False):
        lines.nth(2).click()
        window.comes_to([True, False, is_open, False], high)
    preview.bar.alert("test")
    window.leave()


def strip(guest):
    """Whether the plots are folded, and how far the panel's end is from that of the scene [px]."""
    page = guest.page
    panel = page.locator("[data-floating-window]").filter(has_text="Velocity")
    box, picture = panel.bounding_box(), page.locator("#root").bounding_box()
    assert box is not None
    assert picture is not None
    is_folded = page.get_by_role("img", name="Plot of velocity").filter(visible=True).count() == 0
    return is_folded, picture["y"] + picture["height"] - box["y"] - box["height"]


def test_plots_are_folded_or_not_as_they_were_before_the_window_was_narrow(guest, visit, preview):
    window = visit()
    window.open(preview.url)
    page = window.page

    def resize(size):
        page.set_viewport_size({"width": size[0], "height": size[1]})
        docked = 7 if size == LAPTOP else 0
        window.until(lambda: min(page.locator("[data-dock-tab]").count(), 7) == docked)

    def rests_at(*wanted):
        page.wait_for_timeout(500)  # for what comes late
        window.comes_to(wanted, lambda: strip(window))

    rests_at(True, 12.0)
    page.get_by_role("tab", name="Velocity").click()
    for between, is_folded in ((PHONE, False), (TABLET, True)):
        if is_folded:
            page.get_by_label("Minimize panel").filter(visible=True).click()
        rests_at(is_folded, 12.0)
        resize(between)
        resize(LAPTOP)
        rests_at(is_folded, 12.0)
    window.leave()
