"""Make the pictures of the documentation from the running demo.

Needs Chromium (``make test`` installs one). Run it from anywhere:

    python docs/make_screenshots.py
"""

from __future__ import annotations

import shutil
from pathlib import Path

from playwright.sync_api import Page, sync_playwright
from so101_viewer import serve

from so101_motion.rig import open_simulated

PICTURES = Path(__file__).resolve().parent / "pictures"
SIZE = {"width": 1440, "height": 900}
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def main() -> None:
    """Write ``docs/pictures/preview.png``: the first plan, before it is executed."""
    PICTURES.mkdir(exist_ok=True)
    with (
        open_simulated() as rig,
        serve(rig, port=0) as preview,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(
            executable_path=next(filter(None, map(shutil.which, BROWSERS)), None),
            args=["--no-sandbox"],
        )
        page = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
        page.goto(preview.url)
        page.get_by_role("button", name="Plan", exact=True).click(timeout=60_000)
        page.get_by_text("Planned.").wait_for()
        _settle(page)
        page.screenshot(path=PICTURES / "preview.png")
        print(PICTURES / "preview.png")
        browser.close()


def _settle(page: Page) -> None:
    """Let the panels finish moving, and close the notice about rendering without a GPU."""
    page.wait_for_timeout(2500)
    close = page.locator(".mantine-Notification-closeButton")
    if close.count():
        close.first.dispatch_event("click")
    page.wait_for_timeout(1500)


if __name__ == "__main__":
    main()
