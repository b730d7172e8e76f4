// What a tab answers stands at its top. Where that is scrolled away, it is said over the picture as well.
(() => {
  const link = window.so101;
  const SAID = '.so101-says, .so101-card, .so101-marked:has(> .so101-bad)';
  const LOOK = 100;  // ms
  const DUE = 6000;  // ms after a press; until then what is new is its answer
  let known = new Set();
  let pressed = -Infinity;
  let again = false;  // whether the last press may be refused with the same words as the one before
  let due = 0;

  const words = (node) => node.textContent.replace(/[\d.,]+/g, '');  // a countdown is no news
  const isBad = (node) => node.matches('.so101-bad, .so101-marked');

  // The nearest box, a tab's, is as tall as what is in it; the panel around it scrolls.
  function isAway(node) {
    const { top, bottom } = node.getBoundingClientRect();
    for (let around = node.parentElement; around; around = around.parentElement) {
      if (!/auto|scroll/.test(getComputedStyle(around).overflowY)) continue;
      const seen = around.getBoundingClientRect();
      if (bottom < seen.top + 16 || top > seen.bottom - 16) return true;
    }
    return false;
  }

  function look() {
    due = 0;
    const said = [...document.querySelectorAll(`#root :is(${SAID})`)].filter((node) => node.offsetParent);
    const answers = performance.now() - pressed < DUE;
    const news = said.filter((node) => (known.has(words(node)) ? again && isBad(node) : answers || isBad(node)));
    const away = news.filter(isAway).pop();
    if (away) link.tellReason?.(away.innerText);
    known = new Set(said.map(words));
    again = false;
  }

  const soon = () => { due ||= setTimeout(look, LOOK); };
  addEventListener('DOMContentLoaded', () => {
    new MutationObserver(soon).observe(document.body, { childList: true, subtree: true });
  });
  for (const press of ['click', 'keyup']) addEventListener(press, ({ target }) => {
    if (target.closest?.('[role="tab"]')) return;
    pressed = performance.now();
    if (target.closest?.('.mantine-Button-root')) setTimeout(() => { again = true; soon(); }, 500);
  }, true);
})();
