"""A real Chromium on the real simulated arm.

One browser, one arm and one page serve a module; before each test the arm is brought home.
"""

import os
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest
from harness.browser_user import FEW_PICTURES, HOME, LAPTOP, READY, Guest, move_to
from playwright.sync_api import sync_playwright
from so101_viewer import serve

from so101_motion.common.units import to_mm, to_rad
from so101_motion.rig.simulated_rig import open_simulated

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = ("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking")

LONGEST = 400.0
"""How long a test may take where it does not say so itself [s]: a busy machine draws slowly."""


def pytest_collection_modifyitems(items):
    for item in items:
        if not item.path.is_relative_to(Path(__file__).parent):
            continue
        if not item.get_closest_marker("emulator_only"):
            item.add_marker(pytest.mark.browser)
        if not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(LONGEST))


@pytest.fixture(autouse=True)
def no_thread_outlives_its_test():
    """Here the arm and its page outlive a test; the module answers for their threads."""


@pytest.fixture(scope="module", autouse=True)
def no_thread_outlives_its_module():
    before = set(threading.enumerate())
    yield
    left = [
        thread
        for thread in threading.enumerate()
        if thread.name.startswith("so101-") and thread not in before
    ]
    for thread in left:
        thread.join(10.0)
    assert [thread.name for thread in left if thread.is_alive()] == []


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with sync_playwright() as playwright:
        own = playwright.chromium.executable_path
        found = next(filter(None, map(shutil.which, NAMES)), own)
        if not Path(found).exists():
            pytest.fail(
                "no browser found: the tests in tests/browser need Chromium. "
                "Run `make test`, which installs one, or install chromium yourself."
            )
        # Drawing without a GPU takes every core there is; the arm's control loop goes first.
        # Root's browser would give itself priority again, were it let.
        drop = shutil.which("setpriv") and os.geteuid() == 0
        modest = "setpriv --bounding-set -sys_nice --inh-caps -sys_nice" if drop else ""
        polite = tmp_path_factory.mktemp("browser") / "chromium"
        polite.write_text(f'#!/bin/sh\nexec nice -n 15 {modest} "{found}" "$@"\n')
        polite.chmod(0o755)
        browser = playwright.chromium.launch(executable_path=polite, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.fixture(scope="module", autouse=True)
def own_files(tmp_path_factory):
    """Where the page keeps the user's files: never in the home of the person who runs the tests."""
    folder = tmp_path_factory.mktemp("data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(folder))
        yield folder / "so101_motion"


@pytest.fixture(scope="module")
def rig():
    with open_simulated(speed=to_rad(180.0), acceleration=to_rad(500.0)) as rig:
        yield rig


@pytest.fixture(scope="module")
def preview(rig):
    with serve(rig, port=0) as preview:
        yield preview


@pytest.fixture(scope="module")
def visit(browser):
    """Opens windows of a browser that knows no key yet."""
    contexts = []

    def new(size=LAPTOP, *, dark=False):
        width, height = size
        context = browser.new_context(
            viewport={"width": width, "height": height},
            device_scale_factor=0.5,  # drawn without a GPU: a quarter of the pixels
            color_scheme="dark" if dark else "light",
        )
        context.add_init_script(FEW_PICTURES)
        contexts.append(context)
        context.set_default_timeout(90_000)  # a busy machine draws late
        guest = Guest(page=context.new_page(), problems=[], asked=[])
        guest.page.on("pageerror", lambda error: guest.problems.append(str(error)))
        guest.page.on("request", lambda request: guest.asked.append(request.url))
        return guest

    yield new
    for context in contexts:
        context.close()


@pytest.fixture(scope="module")
def opened(visit, preview):
    guest = visit()
    guest.open(preview.url)
    return guest


@pytest.fixture
def guest(opened, rig):
    """A window on an arm that is at home, with nothing planned and a target aside."""
    rig.arm.stop()
    rig.arm.set_speed(to_rad(180.0))
    move_to(rig, HOME)
    width, height = LAPTOP
    opened.page.set_viewport_size({"width": width, "height": height})
    opened.until(lambda: opened.page.locator("[data-dock-tab]").count() > 6)  # built anew
    opened.page.get_by_role("tab", name="Move").click()
    opened.press("ready")
    ready_mm = to_mm(rig.arm.model.frame(READY, "jaw_tip").p)
    opened.until(lambda: np.allclose(opened.target_mm(), ready_mm, atol=0.1))
    opened.until(lambda: opened.button("Execute").is_disabled())  # no plan of before is left
    opened.until(lambda: opened.button("Plan").is_enabled())
    return opened
