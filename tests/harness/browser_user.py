"""A person at the page in a real browser: mouse, keyboard, and what is drawn.

The page tells its state through the hooks that viser's own tests use (``window.__viser…``), so the
tests look at nodes and widgets and hardly at pixels.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import pytest
from axe_playwright_python.base import AXE_SCRIPT
from playwright.sync_api import Page, TimeoutError

from so101_motion.common.named_poses import POSES
from so101_motion.common.units import to_rad
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import FaultEvent, parse_fault
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel

T = TypeVar("T")

HOME = np.zeros(5)
READY = next(pose.q for pose in POSES if pose.name == "ready")

ASIDE = np.radians([100.0, 0.0, 0.0, 0.0, 0.0])
LAPTOP, PHONE = (1280, 720), (400, 800)

FEW_PICTURES = """
window.rests = false;
const gone = new Set();
window.requestAnimationFrame = (draw) => {
  const look = () => {
    if (window.rests) setTimeout(look, 500);
    else if (!gone.delete(id)) draw(performance.now());
  };
  const id = setTimeout(look, 125);
  return id;
};
window.cancelAnimationFrame = (id) => gone.add(id);
window.draws = false;
for (const way of ['Arrays', 'ArraysInstanced', 'Elements', 'ElementsInstanced']) {
  const draw = WebGL2RenderingContext.prototype['draw' + way];
  WebGL2RenderingContext.prototype['draw' + way] = function (...what) {
    if (window.draws) draw.apply(this, what);
  };
}
"""
"""Eight pictures of the scene a second, none in a window that rests, and nothing in them until it
``draws``: drawn without a GPU, each costs a quarter of a second of processor.
"""

NO_PICTURES = (
    FEW_PICTURES
    + """
const GL = WebGL2RenderingContext, known = {
  getShaderParameter: () => true,
  getProgramParameter: (_, what) => what === GL.LINK_STATUS ? true : 0,
  getShaderInfoLog: () => '', getProgramInfoLog: () => '', getError: () => 0,
  checkFramebufferStatus: () => GL.FRAMEBUFFER_COMPLETE,
};
const asked = /^(get|is|create|fence|clientWait)/;
for (const [name, { value }] of Object.entries(Object.getOwnPropertyDescriptors(GL.prototype)))
  if (typeof value === 'function' && name !== 'constructor')
    GL.prototype[name] = known[name] ?? (asked.test(name) ? value : () => {});
"""
)
"""Nothing is drawn at all. Where things are in the picture, and in which colour, the page knows."""


LOOK_FOR_BARRIERS = """
async () => {
  const found = await axe.run(document, {
    resultTypes: ['violations'],
    runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa'],
    preload: false,  // it would fetch what the page has loaded once more, and wait for that
  });
  return found.violations
    .filter(({ impact }) => ['serious', 'critical'].includes(impact))
    .flatMap(({ id, nodes }) => nodes.map(({ html }) => `${id}: ${html.slice(0, 120)}`));
}
"""


@dataclass
class Guest:
    """One window on the page, the errors its scripts raised, and the addresses it requested."""

    page: Page
    problems: list[str]
    asked: list[str]

    def open(self, url):
        self.page.goto(url)
        self.see_the_arm()

    def see_the_arm(self):
        self.page.wait_for_function(
            "() => window.__viserSceneTree && '/live/gripper_link' in "
            "window.__viserSceneTree.getState()"
        )
        self.until(lambda: self.button("Plan").count() == 1)

    def leave(self):
        self.page.context.close()

    def resize(self, size):
        """Give the window a size, and wait until the page has built its panels anew."""
        self.page.set_viewport_size({"width": size[0], "height": size[1]})
        docked = 8 if size[0] >= 1100 else 0
        self.until(lambda: min(self.page.locator("[data-dock-tab]").count(), 8) == docked)

    def fold_plots(self):
        """Fold the plots if they are open; they may go by themselves at any moment."""
        plots = self.page.get_by_label("Minimize panel").filter(visible=True)
        plots.evaluate_all("panels => panels.forEach(each => each.click())")

    def in_front(self, tab):
        self.page.get_by_role("tab", name=tab, exact=True).filter(visible=True).first.click()

    def button(self, name):
        return self.page.get_by_role("button", name=name, exact=True)

    def press(self, name):
        self.button(name).click()

    def press_next(self, name):
        """Press a button that may have come where the last one was: at once, the page would take it
        for the second click of a double click."""
        self.until(lambda: self.button(name).is_enabled())
        self.page.wait_for_timeout(700)
        self.press(name)

    def plan(self):
        """Have the page plan; again where it hears of a new speed or scene only meanwhile."""

        def is_planned():
            if self.says("Press Plan again."):
                self.press("Plan")
                self.page.wait_for_timeout(1000)
            return self.button("Execute").is_enabled()

        self.press("Plan")
        self.page.wait_for_timeout(300)  # a former plan may be executed until this one is begun
        self.until(is_planned)

    def click_until(self, place, condition):
        """Click at ``place`` until ``condition`` holds; again only where nothing comes of a click
        for seconds, as the page may not know yet what one is for.
        """
        for _ in range(10):
            self.page.mouse.click(*place())
            for _ in range(100):
                if condition():
                    return
                self.page.wait_for_timeout(50)
        self.until(condition)

    def double_click(self, x, y):
        """Click twice within a tenth of a second, however late the page gets round to it."""
        mouse, began = self.page.context.new_cdp_session(self.page), time.time()
        for k, kind in enumerate(("mousePressed", "mouseReleased") * 2):
            told = {"type": kind, "x": x, "y": y, "button": "left", "clickCount": 1 + k // 2}
            mouse.send("Input.dispatchMouseEvent", told | {"timestamp": began + 0.05 * (k // 2)})
        mouse.detach()

    def says(self, words):
        return self.page.get_by_text(words).count() > 0

    def let_go(self, is_limp):
        """Press Let go and answer its question; again where the page asks no longer."""
        asks = self.page.locator("#so101-buttons .asks")

        def is_answered():
            if not asks.count():
                self.press("Let go")
            self.page.wait_for_timeout(800)  # a double click is no answer
            with suppress(TimeoutError):
                asks.click(timeout=5000)
            for _ in range(100):
                if is_limp():
                    return True
                self.page.wait_for_timeout(50)
            return False

        self.until(is_answered)

    def _looks(self, seconds):
        """Time for one look after the other, more and more seldom: each costs the processor up to
        ten milliseconds."""
        waited, pause = 0.0, 50.0
        while waited < 1000.0 * seconds:
            yield
            self.page.wait_for_timeout(pause)
            waited, pause = waited + pause, min(1.3 * pause, 400.0)

    def until(self, condition, *, seconds=60.0):
        """Wait for ``condition`` and let the page live meanwhile; fail when it never comes."""
        for _ in self._looks(seconds):
            if condition():
                return
        pytest.fail(f"did not come true within {seconds:g} s; the page said: {self.words()!r}")

    def comes_to(self, wanted, look):
        """Wait until ``look`` finds what is wanted; fail with what it has found instead."""
        for _ in self._looks(60.0):
            found = look()
            if found == wanted:
                return
        assert found == wanted

    def _learn(self, script, told=None):
        """What a script finds out, as soon as the page knows it."""
        found = []

        def is_known():
            found[:] = [self.page.evaluate(script, told)]
            return found[0] is not None

        self.until(is_known)
        return found[0]

    def color_of(self, part):
        """The colour of a part of the arm on the stage, as a number of the form 0xrrggbb."""
        color = self._learn(
            "part => { const nodes = window.__viserSceneTree.getState();"
            " const name = Object.keys(nodes).find((name) => name.startsWith(part));"
            " return name ? [...nodes[name].message.props.color] : null; }",
            part,
        )
        red, green, blue = color
        return (red << 16) + (green << 8) + blue

    def barriers(self):
        """Barriers that axe calls serious for people with a disability."""
        if not self.page.evaluate("'axe' in window"):
            self.page.evaluate(AXE_SCRIPT)
        return self.page.evaluate(LOOK_FOR_BARRIERS)

    def finger(self, *way):
        """Put a finger on the page, lead it along points [px], and lift it."""
        touch = self.page.context.new_cdp_session(self.page)
        for k, (x, y) in enumerate(way):
            kind = "touchMove" if k else "touchStart"
            told = {"type": kind, "touchPoints": [{"x": x, "y": y}]}
            touch.send("Input.dispatchTouchEvent", told)
            self.page.wait_for_timeout(60)
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        touch.detach()

    def words(self):
        return self.page.inner_text("body")

    def nodes(self):
        return set(self.page.evaluate("Object.keys(window.__viserSceneTree.getState())"))

    def sees(self, node):
        """Whether a node is there and not hidden."""
        seen = self.page.evaluate(
            "name => window.__viserSceneTree.getState()[name]?.effectiveVisibility ?? false", node
        )
        return seen

    def pose_of(self, node):
        """Where the browser has a node: ``position`` [m] and ``wxyz``."""
        pose = self._learn(
            "name => { const d = window.__viserMutable.nodePoseData[name];"
            " const known = d?.position && d?.wxyz;"
            " return known ? {position: [...d.position], wxyz: [...d.wxyz]} : null; }",
            node,
        )
        return pose

    def place_of(self, node, p=(0.0, 0.0, 0.0)):
        """Where a point ``p`` [m] of a node is in the window [px]."""
        x, y = self._learn(
            """([node, p]) => {
                const there = window.__viserMutable.nodeRefFromName[node];
                if (!there) return null;  // not built yet
                const canvas = window.__viserMutable.canvas.getBoundingClientRect();
                const at = there.position.clone().set(...p);
                there.localToWorld(at).project(window.__viserMutable.camera);
                return [canvas.left + (at.x + 1) / 2 * canvas.width,
                        canvas.top + (1 - at.y) / 2 * canvas.height];
            }""",
            [node, list(p)],
        )
        return x, y

    def picture(self):
        """Where the picture of the scene is, once it rests: left, top, width, height [px]."""
        seen = [None]
        canvas = self.page.locator("#root canvas").first

        def rests():
            seen.append(canvas.bounding_box())
            self.page.wait_for_timeout(300)
            return seen[-1] is not None and seen[-1] == seen[-2]

        self.until(rests)
        box = seen[-1]
        assert box is not None
        return box["x"], box["y"], box["width"], box["height"]

    def end_of_path(self):
        """The last point of the line to the target, as the browser has it [m]."""
        point = self._learn(
            "() => { const path = window.__viserSceneTree.getState()['/path'];"
            " return path ? Array.from(path.message.props.points).slice(-3) : null; }"
        )
        return point

    def fields(self, label):
        """The number fields behind a label."""
        return self.page.locator(
            f"xpath=//*[text()='{label}']/ancestor::*[.//input][1]//input[not(@type='hidden')]"
        )

    def target_mm(self):
        """What the three fields of the target say, which the page may just build anew."""
        said = []

        def are_there():
            said[:] = self.fields("Target (mm)").evaluate_all("all => all.map((its) => its.value)")
            return len(said) == 3 and all(said)

        self.until(are_there)
        return tuple(map(float, said))

    def type_target(self, *target_mm):
        fields = self.fields("Target (mm)")
        for k, value in enumerate(target_mm):
            fields.nth(k).click()
            self.page.keyboard.press("Control+A")
            self.page.keyboard.type(f"{value:g}")  # at once, the field may take "-120" for "-0"
            fields.nth(k).press("Enter")
            self.page.wait_for_timeout(80)  # the page sends one message per panel every 50 ms
        self.until(lambda: self.target_mm() == target_mm)


def move_to(rig, q):
    rig.arm.move(JointGoal(q=q), wait=False).result(60.0)


def crawl_aside(rig):
    """Set out on a move that takes over a minute, longer than a busy browser draws."""
    rig.arm.set_speed(to_rad(180.0))
    move_to(rig, -ASIDE)
    rig.arm.set_speed(to_rad(3.0))
    rig.arm.move(JointGoal(q=ASIDE), wait=False)


class Servos(Emulator):
    """The servos of ``so101 emulate`` in this process: they lag, brake, and press on things."""

    def __init__(self, port, clock):
        weight = RobotModel.load().gravity_torque
        super().__init__(EmulatorOptions(link=port), now=clock.now, gravity=weight)

    def type(self, line):
        """What is typed into ``so101 emulate``: a fault that begins, or ``end`` and its name."""
        if line.startswith("end "):
            self.end(FaultEvent(kind=line.removeprefix("end ")))
        else:
            self.begin(parse_fault(line))
