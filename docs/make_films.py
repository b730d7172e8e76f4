"""Make the two short films of the README from the running page.

    python docs/make_films.py [NAME ...]

Each picture of a film is a screenshot of the page, drawn without a GPU, which takes far longer than
the picture is shown. So the simulated arm runs on a clock that this script advances by one picture
at a time: a film plays at the arm's own speed however slow the computer is. A pointer is drawn in,
because screenshots have none.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
from make_screenshots import PATIENCE, PICTURES, START_DEG, TABLE, Guest, launched, open_page
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from so101_motion.common.clock import ManualClock
from so101_motion.common.units import to_rad
from so101_motion.files.scene_file import read_scene
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated

WINDOW, SIZE = (1360, 780), (1088, 624)
PER_SECOND = 12
LARGEST = 2_000_000  # [byte]

ON_DEMAND = """
window.drawn = 0;
const gone = new Set();
let frozen = false;
window.requestAnimationFrame = (draw) => {
  const look = () => {
    if (frozen) return setTimeout(look, 30);
    if (gone.delete(id)) return;
    const before = window.drawn;
    draw(performance.now());
    if (window.drawn > before) frozen = true;
  };
  const id = setTimeout(look, 30);
  return id;
};
window.cancelAnimationFrame = (id) => gone.add(id);
let wanted = false;
for (const way of ['Arrays', 'ArraysInstanced', 'Elements', 'ElementsInstanced']) {
  const draw = WebGL2RenderingContext.prototype['draw' + way];
  WebGL2RenderingContext.prototype['draw' + way] = function (...what) {
    if (wanted) { draw.apply(this, what); window.drawn++; }
  };
}
window.drawOne = () => new Promise((done) => {
  wanted = true;
  const look = () => frozen ? done() : setTimeout(look, 30);
  look();
});
window.goOn = () => { wanted = frozen = false; };
addEventListener('DOMContentLoaded', () => {
  const pointer = document.createElement('div');
  pointer.innerHTML = '<svg width="22" height="28"><path d="M1 1v21l5-5 4 9 4-2-4-8h8z"'
    + ' fill="#111" stroke="#fff" stroke-width="1.5"/></svg>';
  pointer.style = 'position:fixed;z-index:99999;pointer-events:none;left:-40px;top:0';
  document.body.append(pointer);
  addEventListener('pointermove', (event) => {
    pointer.style.left = event.clientX + 'px';
    pointer.style.top = event.clientY + 'px';
  }, true);
});
"""
"""The scene is drawn once when ``drawOne`` asks, and stays until ``goOn``."""


class Film:
    """The pictures of one film; taking one lets the arm's time pass by one picture."""

    def __init__(self, page: Page, clock: ManualClock) -> None:
        self.page = page
        self.guest = Guest(page, [], [])
        self.clock = clock
        self.pictures: list[Image.Image] = []
        self.lengths_ms: list[int] = []
        self.at = (WINDOW[0] / 3, WINDOW[1] / 2)

    def shoot(self, *, seconds: float = 1 / PER_SECOND) -> None:
        """Take a picture that is shown for so long."""
        self.clock.advance(seconds)
        self.page.wait_for_timeout(350)  # until the browser has heard of it
        self.page.evaluate("drawOne()")
        seen = Image.open(BytesIO(self.page.screenshot(timeout=PATIENCE))).convert("RGB")
        self.page.evaluate("goOn()")
        self.pictures.append(seen.resize(SIZE, Image.Resampling.LANCZOS))
        self.lengths_ms.append(round(1000 * seconds))

    def point(self, x: float, y: float, pictures: int = 5) -> None:
        """Lead the pointer to a place in the window [px]."""
        way = np.linspace(self.at, (x, y), pictures + 1)[1:]
        for at in way:
            self.page.mouse.move(*map(float, at))
            self.shoot()
        self.at = (x, y)

    def press(self, name: str, pictures: int = 5) -> None:
        """Lead the pointer to a button and press it."""
        button = self.guest.button(name).filter(visible=True).first
        expect(button).to_be_enabled(timeout=PATIENCE)
        box = button.bounding_box()
        assert box is not None
        self.point(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, pictures)
        self.page.mouse.down()
        self.page.mouse.up()

    def fold_curves(self) -> None:
        """Fold the curves of the plan, which lie over the arm in a window this small."""
        self.page.wait_for_timeout(1500)
        self.page.get_by_label("Minimize panel").filter(visible=True).first.click()
        self.page.wait_for_timeout(1000)

    def write(self, file: Path) -> None:
        """Write the film, which plays again and again.

        Raises:
            ValueError: It is larger than the front page of a repository should load.
        """
        first, *others = self.pictures
        first.save(
            file,
            save_all=True,
            append_images=others,
            duration=self.lengths_ms,
            loop=0,
            quality=60,
            method=6,
        )
        if file.stat().st_size > LARGEST:
            raise ValueError(f"{file} has {file.stat().st_size} bytes; at most {LARGEST}")


def around(browser: Browser, file: Path) -> None:
    """Drag the target to the other side of a wall, plan, and let the arm go around it."""
    with _at_the_wall(browser) as (film, rig):
        guest, mouse = film.guest, film.page.mouse
        film.shoot(seconds=0.8)
        film.point(*guest.place_of("/target", (0.0, 0.085, 0.0)))
        mouse.down()
        film.point(*guest.place_of("/target", (0.0, 0.085 + 0.36, 0.0)), pictures=18)
        mouse.up()
        film.shoot(seconds=0.5)
        film.press("Plan")
        guest.until(lambda: guest.says("Planned."), seconds=PATIENCE / 1000)
        film.fold_curves()
        film.shoot(seconds=1.2)
        film.press("Execute")
        film.guest.until(lambda: rig.arm.state.arm_moving)
        while rig.arm.state.arm_moving:
            film.shoot()
        film.shoot(seconds=1.5)
        film.write(file)


def stop(browser: Browser, file: Path) -> None:
    """Press STOP in the middle of that motion."""
    with _at_the_wall(browser) as (film, rig):
        guest = film.guest
        guest.type_target(190.0, 200.0, 100.0)
        guest.plan()
        film.fold_curves()
        film.shoot(seconds=0.8)
        film.press("Execute")
        guest.until(lambda: rig.arm.state.arm_moving)
        stops = rig.arm.stops
        film.press("STOP", pictures=13)
        guest.until(lambda: rig.arm.stops > stops)
        while rig.arm.state.arm_moving:
            film.shoot()
        film.shoot(seconds=2.5)
        film.write(file)


FILMS = {film.__name__: film for film in (around, stop)}


@contextmanager
def _at_the_wall(browser: Browser) -> Iterator[tuple[Film, Rig]]:
    clock, start = ManualClock(), to_rad(np.array(START_DEG))
    with (
        open_simulated(scene=read_scene(TABLE), q_start=start, clock=clock) as rig,
        open_page(browser, rig, size=WINDOW, script=ON_DEMAND) as page,
    ):
        film = Film(page, clock)
        film.guest.see_the_arm()
        page.wait_for_timeout(3500)
        close = page.locator(".mantine-Notification-closeButton")
        if close.count():
            close.first.dispatch_event("click")
        yield film, rig


def main() -> None:
    """Write the films that are named, or both."""
    with launched() as browser:
        for name in sys.argv[1:] or FILMS:
            file = PICTURES / f"{name}.webp"
            FILMS[name](browser, file)
            print(file, file.stat().st_size)


if __name__ == "__main__":
    main()
