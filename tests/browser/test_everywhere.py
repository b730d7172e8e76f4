"""What holds on all tabs and in windows of any size: Stop on top, targets for fingers, the Tab key,
and no tools for developers."""

import numpy as np
from harness.browser_user import ASIDE, LAPTOP, PHONE

from so101_motion.common.units import to_rad

TABS = ("Move", "Jog", "Program", "World", "Share", "Teach", "Pick")

AT_STOP = """() => {
    const { x, y, width, height } = document.querySelector('#so101-stop').getBoundingClientRect();
    const spots = [[.5, .5], [.05, .1], [.95, .9]];
    return spots.every(([right, down]) =>
        document.elementFromPoint(x + right * width, y + down * height)?.id === 'so101-stop');
}"""

FOR_DEVELOPERS = ("Dev Settings", "Orbit Origin Tool", "Return to GUI", "Scene tree")

ICONS_FOR_DEVELOPERS = ".tabler-icon-adjustments, .tabler-icon-arrow-back"  # of nameless buttons

SMALL_TARGETS = """() => {
    const targets = document.querySelectorAll(
        'button, input:not([type=hidden]), [role=tab], [role=slider], [role=button], textarea, a');
    const seen = [...targets].filter((each) => each.checkVisibility({ visibilityProperty: true }));
    const size = (each) => {
        const around = each.closest('.mantine-Slider-root') ?? each;
        const { width, height } = around.getBoundingClientRect();
        return Math.min(width, height);
    };
    return seen.filter((each) => size(each) > 0 && size(each) < 43.5)
        .map((each) => `${each.tagName} ${each.getAttribute('aria-label') ?? each.innerText}: `
            + `${size(each).toFixed(0)} px`);
}"""

CONTROLS = """() => {
    window.known ??= new Map();
    window.called ??= (each) => {
        if (!window.known.has(each)) window.known.set(each, window.known.size);
        const name = each.getAttribute('aria-label') || each.innerText || each.tagName;
        return `${window.known.get(each)} ${name}`.trim();
    };
    return [...document.querySelectorAll(
            'button, input:not([type=hidden]), [role=slider], textarea')]
        .filter((each) => each.checkVisibility({ visibilityProperty: true }) && !each.disabled
            && !each.closest('.mantine-Notification-root') && each.tabIndex !== -1)
        .map(window.called);
}"""

LOOK_WHAT_IS_REACHED = """() => {
    if (!window.reached)
        addEventListener('focusin', ({ target }) => window.reached.add(window.called(target)));
    window.reached = new Set();
}"""

UNREACHABLE = """() => [...document.querySelectorAll(
        '#root button, #root [role=tab], #so101-bar button, #so101-views button')]
    .filter((each) => each.checkVisibility({ visibilityProperty: true }) && !each.disabled
        && each.tabIndex < 0 && each.getAttribute('role') !== 'tab'
        && !each.matches('.mantine-NumberInput-control'))  // the arrow keys do the same
    .map((each) => each.getAttribute('aria-label') || each.outerHTML.slice(0, 120))"""


def test_at_any_size_nothing_covers_stop_and_targets_fit_a_finger(guest, rig, crawl):
    page = guest.page
    for size in (PHONE, (820, 1180), (1024, 700), LAPTOP):
        guest.resize(size)
        for name in TABS if size in (PHONE, (820, 1180)) else ():
            guest.in_front(name)
            page.wait_for_timeout(150)
            guest.comes_to([], lambda: page.evaluate(SMALL_TARGETS))
        guest.in_front("Move")
        crawl()
        page.keyboard.press("Control+k")  # where viser has a list of commands
        guest.fields("Target for").first.click()
        guest.until(lambda: page.get_by_role("option", name="jaw tip").is_visible())
        assert page.evaluate(AT_STOP)
        page.locator("#so101-stop").click()
        guest.until(lambda: not rig.arm.state.arm_moving)
        assert np.abs(rig.arm.state.q - ASIDE).max() > to_rad(1.0), "it has not arrived"
        page.keyboard.press("Escape")
        for words in FOR_DEVELOPERS:
            assert page.get_by_text(words).filter(visible=True).count() == 0
            assert page.get_by_label(words).filter(visible=True).count() == 0
        assert page.locator(ICONS_FOR_DEVELOPERS).filter(visible=True).count() == 0


def test_the_tab_key_reaches_every_control(guest):
    page = guest.page

    def all_there():
        """The controls, once the page has built them all."""
        found = [set(), set()]
        while len(found[-1]) <= 8 or found[-1] != found[-2]:
            page.wait_for_timeout(300)
            found.append(set(page.evaluate(CONTROLS)))
        return found[-1]

    def missed():
        wanted = left = all_there()
        page.evaluate(LOOK_WHAT_IS_REACHED)
        for _ in range(len(wanted) // 10 + 3):
            for _ in range(20):
                page.keyboard.press("Tab")
            left = wanted - set(page.evaluate("[...window.reached]"))
            if not left:
                break
        return left

    for name in TABS:
        page.get_by_role("tab", name=name, exact=True).click()
        wanted = all_there()
        guest.comes_to([], lambda: page.evaluate(UNREACHABLE))
        left = missed()
        if left and all_there() != wanted:  # the page has built some anew meanwhile
            left = missed()
        assert left == set(), name
    page.get_by_role("tab", name="Move").click()
