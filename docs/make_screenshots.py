"""Make the pictures of the documentation from the running pages.

Needs Chromium (``make test`` installs one). Run it from anywhere:

    python docs/make_screenshots.py [NAME ...]

The pages are drawn without a GPU, which takes all the processor there is. So nothing is drawn until
a picture is taken, and buttons are pressed without waiting for the scene to be drawn.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, Page, expect, sync_playwright
from so101_viewer.app import serve
from so101_viewer.setup_app import serve_setup
from so101_viewer.source import Source

from so101_motion.common.units import to_rad
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.files.scene_file import read_scene
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.request import Plan
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.tasks.sweeps import Atlas, ReachSweep, run_sweep

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from harness.browser_user import FEW_PICTURES  # noqa: E402  # it lives with the tests
from harness.browser_user import Guest as Guest  # noqa: E402  # for the films

PICTURES = ROOT / "docs" / "pictures"
TABLE = ROOT / "examples" / "table.json"
DESK, PHONE = (1440, 900), (400, 800)
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
START_DEG = (65.0, -20.0, 30.0, 50.0, 0.0)
PATIENCE = 180_000  # [ms]; a busy machine

DRAW_AND_FREEZE = """
() => new Promise((done) => {
  let drawn = 0;
  Object.defineProperty(window, 'draws', { get: () => ++drawn });
  const look = () => {
    if (drawn < 400) return setTimeout(look, 100);  // viser draws a scene at rest once a second
    window.requestAnimationFrame = () => 0;  // what is drawn stays
    done();
  };
  look();
})
"""


def main() -> None:
    """Write the pictures that are named, or all."""
    PICTURES.mkdir(exist_ok=True)
    with launched() as browser:
        for name in sys.argv[1:] or SHOTS:
            SHOTS[name](browser, PICTURES / f"{name}.png")
            print(PICTURES / f"{name}.png")


@contextmanager
def launched() -> Iterator[Browser]:
    """Chromium, without a window."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=next(filter(None, map(shutil.which, BROWSERS)), None),
            args=["--no-sandbox"],
        )
        yield browser
        browser.close()


def obstacles(browser: Browser, file: Path) -> None:
    """A plan over a wall."""
    with _at_the_wall() as (rig, plan), open_page(browser, rig, plan=plan) as page:
        page.get_by_text("Planned.").wait_for(timeout=PATIENCE)
        _take(page, file)


def dark(browser: Browser, file: Path) -> None:
    """The world, in the dark."""
    with _at_the_wall() as (rig, plan), open_page(browser, rig, plan=plan, scheme="dark") as page:
        _open_tab(page, "World")
        _take(page, file)


def phone(browser: Browser, file: Path) -> None:
    """A plan on a phone."""
    with _at_the_wall() as (rig, plan), open_page(browser, rig, plan=plan, size=PHONE) as page:
        page.get_by_text("Planned.").first.wait_for(timeout=PATIENCE)
        _take(page, file)


def atlas(browser: Browser, file: Path) -> None:
    """Half of what the arm reaches, cut through its middle."""
    with tempfile.TemporaryDirectory() as folder:
        run_sweep(ReachSweep(spacing=0.02), Path(folder) / "atlas")
        reach = Atlas.read(Path(folder) / "atlas")
    with open_simulated() as rig, open_page(browser, rig, atlas=reach) as page:
        page.get_by_role("tab", name="Atlas").click(timeout=PATIENCE)
        page.get_by_label("Slice", exact=True).click(timeout=PATIENCE)
        page.get_by_role("option", name="at one y").click(timeout=PATIENCE)
        _take(page, file)


def setup(browser: Browser, file: Path) -> None:
    """A calibration: four joints have been at both their stops, the fifth is on its way."""
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder) / "arm"
        servos = Emulator(EmulatorOptions(link=link, calibrated=False), gravity=np.zeros_like)

        def put(share: float, joints: tuple[str, ...]) -> None:
            with servos.world.lock:
                for joint in joints:
                    shaft = servos.world.servo(joint).drive.shaft
                    shaft.put(round(shaft.lower + share * (shaft.upper - shaft.lower)))

        done = ("shoulder_pan", "shoulder_lift", "elbow_flex", "gripper")
        put(0.5, (*done, "wrist_flex", "wrist_roll"))
        kept = Path(folder) / "setup.json"
        with (
            serve_setup(port=0, ports=[str(link)], reply_timeout=0.5, progress_file=kept) as app,
            _window(browser, app.url, DESK, "light") as page,
        ):
            for name, then in (
                ("Calibration Only", "Step 1 of 7"),
                ("Next", "Step 2 of 7"),
                ("Next", "one hand on the arm"),
                ("Start the calibration", "The blue ghost shows the pose"),
                ("I hold it there", "The pose is taken"),
                ("Next", "Still to do: shoulder_pan"),
            ):
                _press(page, name)
                page.get_by_text(then).first.wait_for(timeout=PATIENCE)
            is_seen = page.get_by_text("Still to do: wrist_flex").first.is_visible
            for _ in range(10):  # a busy machine may miss a stop
                for share in (*np.linspace(0.5, 0.0, 30), *np.linspace(0.0, 1.0, 60), *[1.0] * 8):
                    put(float(share), done)
                    put(0.25 + 0.5 * float(share), ("wrist_flex",))
                    page.wait_for_timeout(40)
                if is_seen():
                    break
            put(0.6, done)
            _take(page, file)
        servos.close()


SHOTS: dict[str, Callable[[Browser, Path], None]] = {
    shot.__name__: shot for shot in (obstacles, dark, phone, atlas, setup)
}


@contextmanager
def _at_the_wall() -> Iterator[tuple[Rig, Plan]]:
    start = to_rad(np.array(START_DEG))
    with open_simulated(scene=read_scene(TABLE), q_start=start) as rig:
        yield rig, rig.arm.plan(PoseGoal.at_point((0.19, 0.2, 0.1)))


@contextmanager
def open_page(
    browser: Browser,
    rig: Rig,
    *,
    plan: Plan | None = None,
    atlas: Atlas | None = None,
    size: tuple[int, int] = DESK,
    scheme: str = "light",
    script: str = FEW_PICTURES,
) -> Iterator[Page]:
    """The page of a rig in a window of a size [px], with a script that runs before its own."""
    source = replace(Source.given(rig, "Simulated arm"), atlas=atlas)
    with (
        serve(source, port=0, plan=plan) as served,
        _window(browser, served.url, size, scheme, script) as page,
    ):
        yield page


@contextmanager
def _window(
    browser: Browser, url: str, size: tuple[int, int], scheme: str, script: str = FEW_PICTURES
) -> Iterator[Page]:
    width, height = size
    context = browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme=scheme,  # type: ignore[arg-type]
    )
    context.add_init_script(script)
    page = context.new_page()
    page.goto(url, timeout=PATIENCE)
    try:
        yield page
    finally:
        context.close()


def _press(page: Page, name: str) -> None:
    """Press a button once it is there and can be pressed."""
    button = page.get_by_role("button", name=name, exact=True)
    expect(button).to_be_enabled(timeout=PATIENCE)
    button.evaluate("button => button.click()")


def _open_tab(page: Page, name: str) -> None:
    tab = page.get_by_role("tab", name=name, exact=True)
    tab.click(timeout=PATIENCE)  # a program's click does not turn it
    expect(tab).to_have_attribute("aria-selected", "true", timeout=PATIENCE)


def _take(page: Page, file: Path) -> None:
    """Let the panels finish moving, close the notice about rendering without a GPU, and shoot."""
    page.wait_for_timeout(3500)
    close = page.locator(".mantine-Notification-closeButton")
    if close.count():
        close.first.dispatch_event("click")
    page.wait_for_timeout(2000)
    page.evaluate(DRAW_AND_FREEZE)
    page.screenshot(path=file, timeout=PATIENCE)


if __name__ == "__main__":
    main()
