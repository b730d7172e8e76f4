// Give the widgets that viser leaves nameless a name for screen readers, light the button that was
// chosen in a row, and let keys scroll what is cut and holds nothing that they reach.
(() => {
  const NAMELESS =
    '#root [role="slider"]:not([aria-label]), #root [role="slider"][aria-label=""], ' +
    '#root input:not([type="hidden"]):not([aria-label])';
  const BY_KEYS = 'a[href], button, input, select, textarea, [tabindex]:not([tabindex="-1"])';
  let due = 0;

  function label(node) {
    for (let around = node.parentElement; around; around = around.parentElement) {
      const found = around.querySelector('label');
      if (found) {
        const fields = [...around.querySelectorAll('input:not([type="hidden"])')];
        const k = fields.length === 3 ? fields.indexOf(node) : -1;
        return found.textContent + (k < 0 ? '' : ` ${'XYZ'[k]}`);
      }
    }
    return '';
  }

  function light(told, word) {
    for (let around = told.parentElement; around; around = around.parentElement) {
      const buttons = [...around.querySelectorAll('.mantine-Button-root')];
      const found = buttons.find((button) => button.textContent === word);
      if (!found) continue;
      for (const each of found.parentElement.children) {
        each.setAttribute('aria-pressed', each === found);
      }
      return;
    }
  }

  function reach(area) {
    const { scrollWidth, clientWidth, scrollHeight, clientHeight } = area;
    const isCut = scrollWidth > clientWidth || scrollHeight > clientHeight;
    if (isCut && !area.querySelector(BY_KEYS)) area.tabIndex = 0;  // for good: it may have the focus
  }

  function name() {
    due = 0;
    document.querySelectorAll('.mantine-ScrollArea-viewport').forEach(reach);
    for (const told of document.querySelectorAll('[data-chosen]')) {
      for (const word of told.dataset.chosen.split(' ')) light(told, word);
    }
    for (const node of document.querySelectorAll(NAMELESS)) {
      const text = label(node);
      if (text) node.setAttribute('aria-label', text);
    }
    for (const node of document.querySelectorAll('[role="progressbar"]:not([aria-label])')) {
      node.setAttribute('aria-label', 'Progress');
    }
    // The button that opens a folded panel stands among the panel's tabs.
    for (const node of document.querySelectorAll('[role="tablist"] [role="button"]')) {
      node.setAttribute('role', 'tab');
    }
    for (const node of document.querySelectorAll('.mantine-CloseButton-root:not([aria-label])')) {
      node.setAttribute('aria-label', 'Close');
    }
  }

  const soon = () => { due ||= setTimeout(name, 300); };
  addEventListener('resize', soon);
  addEventListener('DOMContentLoaded', () => {
    new MutationObserver(soon).observe(document.body, { childList: true, subtree: true });
  });
})();
