"""Make the pictures of the documentation from the running demo.

Needs Chromium (``make test`` installs one). Run it from anywhere:

    python docs/make_screenshots.py
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright
from so101_viewer import serve

from so101_motion.planning.goals import PoseGoal
from so101_motion.rig import open_simulated
from so101_motion.scene_file import read_scene
from so101_motion.units import to_rad

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
TABLE = ROOT / "examples" / "table.json"
SIZE = {"width": 1440, "height": 900}
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def main() -> None:
    """Write the pictures, each a plan before it is executed."""
    PICTURES.mkdir(exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=next(filter(None, map(shutil.which, BROWSERS)), None),
            args=["--no-sandbox"],
        )
        page = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
        with open_simulated() as rig, serve(rig, port=0) as preview:
            page.goto(preview.url)
            page.get_by_role("button", name="Plan", exact=True).click(timeout=60_000)
            _take(page, "preview.png")
        start = to_rad(np.array([65.0, -20.0, 30.0, 50.0, 0.0]))
        with open_simulated(scene=read_scene(TABLE), q_start=start) as rig:
            around = rig.arm.plan(PoseGoal.at_point((0.19, 0.2, 0.1)))
            with serve(rig, port=0, plan=around) as preview:
                page.goto(preview.url)
                _take(page, "obstacles.png")
        browser.close()


def _take(page: Page, name: str) -> None:
    page.get_by_text("Planned.").wait_for(timeout=60_000)
    _settle(page)
    page.screenshot(path=PICTURES / name)
    print(PICTURES / name)


def _settle(page: Page) -> None:
    """Let the panels finish moving, and close the notice about rendering without a GPU."""
    page.wait_for_timeout(2500)
    close = page.locator(".mantine-Notification-closeButton")
    if close.count():
        close.first.dispatch_event("click")
    page.wait_for_timeout(1500)


if __name__ == "__main__":
    main()
