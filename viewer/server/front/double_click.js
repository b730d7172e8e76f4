// Drop the second click of a double click if another button has come under the pointer meanwhile. In a
// setup, where each step has a Next in the same place, always drop it. Until clicks count again, that
// button looks disabled.
(() => {
  const SOON = 600;  // ms, as long as a slow double click takes
  const NEAR = 12;  // px
  let last = null;

  const steps = () => [...document.querySelectorAll('.so101-once')].some((node) => node.offsetParent);
  const name = (button) => button.dataset.value ?? button.textContent;
  const isOther = (button) => name(button) !== last.name || steps();
  let flat = null;  // the button that looks so

  function show() {
    const isSoon = performance.now() - last.t < SOON;
    const there = isSoon ? document.elementFromPoint(last.x, last.y)?.closest('button') : null;
    const now = there && !there.closest('#so101-bar') && isOther(there) ? there : null;
    if (flat !== now) flat?.classList.remove('so101-later');
    flat = now;
    flat?.classList.add('so101-later');
    if (isSoon) setTimeout(show, 30);
  }

  addEventListener('click', (event) => {
    const button = event.target.closest?.('button');
    if (!event.isTrusted || event.detail === 0) return;  // a key, or a program
    if (button?.closest('#so101-bar')) return;  // Stop never waits; the others ask first themselves
    const { clientX: x, clientY: y, timeStamp: t } = event;
    const soon = last && t - last.t < SOON && Math.hypot(x - last.x, y - last.y) < NEAR;
    // A button with another name is another button.
    if (button && soon && isOther(button)) {
      event.preventDefault();
      event.stopImmediatePropagation();
      return;
    }
    last = { x, y, t, name: button ? name(button) : null };
    if (button) setTimeout(show, 30);
  }, true);
})();
