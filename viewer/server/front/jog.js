// Send what is held on the Jog tab to the server, again and again, and at once when it is released.
(() => {
  const link = window.so101;
  const AXES = 7;
  const REPEAT = 20;  // ms; the server lets go when three are missing
  const STILL = 0.15;  // of a gamepad's stick
  const held = new Map();  // pointers and keys: [axis, way]
  let dragging = false;
  let count = 0;
  let timer = 0;
  let hand = null;
  let astray = false;  // whether a stick is still pushed for another arm
  let reported = false;  // whether the server believes that something is held

  // The buttons that are visible (with several arms, those of the tab in front), and whether they are on.
  const seen = () => [...document.querySelectorAll('.so101-jog')].find((each) => each.offsetParent);
  const tab = () => {
    if (!document.hasFocus() || document.hidden) return null;
    const found = seen();
    return found?.dataset.jog === 'on' ? found : null;
  };

  function stick() {
    const values = new Array(AXES).fill(0);
    const pad = navigator.getGamepads?.().find((each) => each?.connected);
    if (!pad || !(pad.buttons[4]?.pressed || pad.buttons[5]?.pressed)) return values;
    const [x0 = 0, y0 = 0, x1 = 0, y1 = 0] = pad.axes;
    const cross = Number(pad.buttons[12]?.pressed ?? 0) - Number(pad.buttons[13]?.pressed ?? 0);
    const jaw = (pad.buttons[7]?.value ?? 0) - (pad.buttons[6]?.value ?? 0);
    const isTool = tab()?.querySelector('[data-axis="5"]');
    // Tool: left stick along X and Y, right stick up and round. Joints: one after the other.
    const axes = isTool ? [-y0, -x0, -y1, 0, cross, -x1, jaw] : [-x0, -y0, -y1, cross, x1, 0, jaw];
    return axes.map((value) => (Math.abs(value) < STILL ? 0 : Math.max(-1, Math.min(1, value))));
  }

  function values() {
    const pushed = stick();
    astray = astray && pushed.some(Boolean);
    const sum = astray ? new Array(AXES).fill(0) : pushed;
    for (const [axis, way] of held.values()) sum[axis] = Math.max(-1, Math.min(1, sum[axis] + way));
    return sum;
  }

  function say() {
    const buttons = tab();
    if (reported && buttons?.dataset.hand !== hand) {
      held.clear();  // it was meant for the arm whose tab was in front
      [dragging, astray] = [false, true];
    }
    const now = buttons ? values() : null;
    const isHeld = now && (now.some(Boolean) || (dragging && buttons.dataset.kind === 'drag'));
    if (isHeld) {
      link.send(buttons.dataset.hand, `${++count} ${now.join(' ')}`);
      hand = buttons.dataset.hand;
      reported = true;
    } else if (reported) {
      link.send(hand, `${++count}`);
      reported = false;
    }
    const goes = isHeld || (buttons && navigator.getGamepads?.().some(Boolean));
    if (goes && !timer) timer = setInterval(say, REPEAT);
    if (!goes && timer) timer = clearInterval(timer) ?? 0;
  }

  function letGo() {
    held.clear();
    dragging = false;
    say();
  }

  addEventListener('pointerdown', (event) => {
    const button = event.target.closest?.('.so101-jog button:not(:disabled)');
    if (button && event.button === 0) {
      event.preventDefault();
      document.activeElement?.blur?.();
      button.setPointerCapture?.(event.pointerId);
      held.set(event.pointerId, [Number(button.dataset.axis), Number(button.dataset.way)]);
      say();
    } else if (event.target.tagName === 'CANVAS' && event.button === 0) {
      dragging = true;
      say();
    }
  }, true);
  for (const end of ['pointerup', 'pointercancel', 'lostpointercapture']) {
    addEventListener(end, (event) => {
      dragging = false;
      if (held.delete(event.pointerId) || reported) say();
    }, true);
  }

  addEventListener('keydown', (event) => {
    if (event.metaKey || event.ctrlKey || event.altKey || [' ', 'Escape'].includes(event.key)) {
      return letGo();  // with a modifier held, the release of a key may never be reported
    }
    if (['INPUT', 'TEXTAREA', 'SELECT'].includes(event.target.tagName)) return;
    const key = event.key.toLowerCase();
    const button = /^[a-z]$/.test(key) ? seen()?.querySelector(`[data-key="${key}"]`) : null;
    if (!button) return;
    event.stopPropagation();  // viser moves its camera with the same keys
    if (event.repeat || !tab()) return;
    held.set(key, [Number(button.dataset.axis), Number(button.dataset.way)]);
    say();
  }, true);
  addEventListener('keyup', (event) => {
    if (held.delete(event.key.toLowerCase())) say();
  }, true);
  addEventListener('contextmenu', letGo, true);
  addEventListener('blur', letGo);
  addEventListener('pagehide', letGo);
  document.addEventListener('visibilitychange', letGo);
  addEventListener('gamepadconnected', () => say());
  link.changed.push(() => { if (!link.connected) letGo(); else say(); });
})();
