"""A real Chromium on the real simulated arm.

One browser, one arm and one page serve all tests here; before each test the arm is brought home.
No stall ends a motion, as an arm's time stands still with the machine. What a browser does late is
waited for, a minute; no test asks how fast it is.
"""

import os
import shutil
import threading
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from harness.browser_user import (
    HOME,
    LAPTOP,
    NO_PICTURES,
    PHONE,
    READY,
    Guest,
    crawl_aside,
    move_to,
)
from harness.clocks import PacedClock
from playwright.sync_api import sync_playwright
from so101_viewer import Source, serve

from so101_motion.common.units import to_mm, to_rad
from so101_motion.planning.collision.scene import Scene
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
    """Here the arm and its page outlive a test."""


@pytest.fixture(scope="package", autouse=True)
def no_thread_outlives_these_tests():
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


@pytest.fixture(scope="package")
def browser(tmp_path_factory):
    with sync_playwright() as playwright:
        own = playwright.chromium.executable_path
        found = next(filter(None, map(shutil.which, NAMES)), own)
        if not Path(found).exists():
            pytest.fail(
                "no browser found: the tests in tests/browser need Chromium. "
                "Run `make test`, which installs one, or install chromium yourself."
            )
        # Root's browser would give itself priority over the arm, were it let.
        drop = "exec setpriv --bounding-set -sys_nice --inh-caps -sys_nice"
        plain = shutil.which("setpriv") is None or os.geteuid() != 0
        modest = tmp_path_factory.mktemp("browser") / "chromium"
        modest.write_text(f'#!/bin/sh\n{"exec" if plain else drop} "{found}" "$@"\n')
        modest.chmod(0o755)
        browser = playwright.chromium.launch(executable_path=modest, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.fixture(scope="package", autouse=True)
def own_files(tmp_path_factory):
    """Where the page keeps the user's files: never in the home of the person who runs the tests."""
    folder = tmp_path_factory.mktemp("data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(folder))
        yield folder / "so101_motion"


@pytest.fixture(scope="package")
def paced():
    """The time of an arm on servos of this process."""
    return PacedClock()


@pytest.fixture(scope="package")
def rig():
    with open_simulated(speed=to_rad(180.0), acceleration=to_rad(500.0)) as rig:
        yield rig


@pytest.fixture(scope="package")
def scene_file(tmp_path_factory):
    return tmp_path_factory.mktemp("scene") / "table.json"


@pytest.fixture(scope="package")
def preview(rig, scene_file):
    source = Source(title="Arm", open=lambda: rig, lasts=True, scene_file=scene_file)
    with serve(source, port=0) as preview:
        yield preview


@contextmanager
def windows(browser):
    """Opens windows of a browser that knows no key yet, and closes them."""
    contexts = []

    def new(size=LAPTOP, *, script=NO_PICTURES, **more):
        context = browser.new_context(
            viewport={"width": size[0], "height": size[1]},
            device_scale_factor=0.5,  # drawn without a GPU: a quarter of the pixels
            **more,
        )
        context.add_init_script(script)
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
def visit(browser):
    with windows(browser) as visit:
        yield visit


@pytest.fixture(scope="package")
def own_windows(browser, preview):
    """The one in which most is done, and one without control; those that rest ask for little."""
    with windows(browser) as visit:
        opened, watching = visit(), visit(PHONE)
        for window in (opened, watching):
            window.open(preview.url)
            window.page.evaluate("window.rests = true")
        yield opened, watching


@contextmanager
def awake(window):
    window.page.evaluate("window.rests = false")
    yield window
    window.page.evaluate("window.rests = true")


@pytest.fixture
def watcher(own_windows, guest):
    """The window without control, as wide as a laptop's."""
    with awake(own_windows[1]) as window:
        window.resize(LAPTOP)
        yield window
        window.resize(PHONE)


@pytest.fixture
def guest(own_windows, rig):
    """A window on an arm that is at home, with nothing planned and a target aside."""
    with awake(own_windows[0]) as guest:
        rig.arm.stop()
        rig.arm.set_speed(to_rad(180.0))
        rig.arm.scene = Scene()
        move_to(rig, HOME)
        guest.resize(LAPTOP)
        guest.fold_plots()  # they lie over what a test clicks on
        guest.in_front("Move")
        guest.press("ready")
        ready_mm = to_mm(rig.arm.model.frame(READY, "jaw_tip").p)
        guest.until(lambda: np.allclose(guest.target_mm(), ready_mm, atol=0.1))
        guest.until(lambda: guest.button("Execute").is_disabled())  # no plan of before is left
        guest.until(lambda: guest.button("Plan").is_enabled())
        yield guest


@pytest.fixture
def crawl(guest, rig):
    """Makes the arm move slowly; called once the windows are open, which takes its time."""

    def begin():
        crawl_aside(rig)
        guest.until(lambda: rig.arm.state.arm_moving and guest.says("Moving"))

    yield begin
    rig.arm.stop()
