"""A person at the page in a real browser: mouse, keyboard, and what is drawn.

The page tells its state through the hooks that viser's own tests use (``window.__viser…``), so the
tests look at nodes and widgets and hardly at pixels.
"""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import pytest
from axe_playwright_python.base import AXE_SCRIPT
from playwright.sync_api import Page, TimeoutError

from so101_motion.common.errors import MotionError
from so101_motion.common.named_poses import POSES
from so101_motion.common.units import to_rad
from so101_motion.planning.goals import JointGoal

T = TypeVar("T")

HOME = np.zeros(5)
READY = next(pose.q for pose in POSES if pose.name == "ready")

ASIDE = np.radians([100.0, 0.0, 0.0, 0.0, 0.0])
LAPTOP, PHONE = (1280, 720), (400, 800)

STALLED = "No setpoint could be sent"

FEW_PICTURES = """
window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 125);
window.cancelAnimationFrame = clearTimeout;
window.draws = false;
for (const way of ['Arrays', 'ArraysInstanced', 'Elements', 'ElementsInstanced']) {
  const draw = WebGL2RenderingContext.prototype['draw' + way];
  WebGL2RenderingContext.prototype['draw' + way] = function (...what) {
    if (window.draws) draw.apply(this, what);
  };
}
"""
"""Eight pictures of the scene a second, and nothing in them unless a test asks for pixels
(``looking``).

Drawn without a GPU, each costs a quarter of a second of processor, which the arm needs. Where
things are in the picture, and in which colour, the page knows as ever.
"""


LOOK_FOR_BARRIERS = """
async (part) => {
  const found = await axe.run(part.closest('.mantine-Paper-root') ?? document, {
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
            "window.__viserSceneTree.getState()",
        )
        self.until(lambda: self.button("Plan").count() == 1)

    def leave(self):
        self.page.context.close()

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

    def has_stalled(self):
        """Whether the page says that a busy machine kept the arm from moving on."""
        return self.page.get_by_text(STALLED).filter(visible=True).count() > 0

    def until(self, condition, *, seconds=60.0):
        """Wait for ``condition`` and let the page live meanwhile; fail when it never comes."""
        for _ in range(round(seconds / 0.05)):
            if condition():
                return
            self.page.wait_for_timeout(50)
        pytest.fail(f"did not come true within {seconds:g} s; the page said: {self.words()!r}")

    def comes_to(self, wanted, look):
        """Wait until ``look`` finds what is wanted; fail with what it has found instead."""
        found = []
        for _ in range(1200):
            found[:] = [look()]
            if found == [wanted]:
                return
            self.page.wait_for_timeout(50)
        assert found[0] == wanted

    def _learn(self, script, told=None):
        """What a script finds out, as soon as the page knows it."""
        found = []

        def is_known():
            found[:] = [self.page.evaluate(script, told)]
            return found[0] is not None

        self.until(is_known)
        return found[0]

    @contextmanager
    def looking(self):
        """Draw the scene in full while a test looks at its pixels."""
        self.page.evaluate("window.draws = true")
        try:
            yield
        finally:
            self.page.evaluate("window.draws = false")

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

    def barriers(self, tab=None):
        """Barriers that axe calls serious for people with a disability; of ``tab`` or all."""
        if not self.page.evaluate("'axe' in window"):
            self.page.evaluate(AXE_SCRIPT)
        found = (tab or self.page.locator("html")).evaluate(LOOK_FOR_BARRIERS)
        return found

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
    """Move the arm there; again where a busy machine had no time for its setpoints."""
    for _ in range(3):
        with suppress(MotionError):
            rig.arm.move(JointGoal(q=q), wait=False).result(60.0)
            return
    rig.arm.move(JointGoal(q=q), wait=False).result(60.0)


def crawl_aside(rig):
    """Set out from home on a move that takes half a minute."""
    rig.arm.set_speed(to_rad(180.0))
    move_to(rig, HOME)
    rig.arm.set_speed(to_rad(3.0))
    rig.arm.move(JointGoal(q=ASIDE), wait=False)


class Servos:
    """``so101 emulate`` in a process of its own: its servos lag, brake, and press on things."""

    def __init__(self, port):
        command = (sys.executable, "-m", "so101_motion.cli", "emulate", "--realtime", "--link")
        self._process = subprocess.Popen(
            [*command, port], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        self._process.stdout.readline()

    def type(self, line):
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()

    def close(self):
        self._process.terminate()
        self._process.wait(10.0)
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()
