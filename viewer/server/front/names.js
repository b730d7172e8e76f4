// Give the widgets that viser leaves nameless a name for screen readers, and light the button that was
// chosen in a row.
(() => {
  const NAMELESS =
    '#root [role="slider"]:not([aria-label]), #root [role="slider"][aria-label=""], ' +
    '#root input:not([type="hidden"]):not([aria-label])';
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

  function name() {
    due = 0;
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

  addEventListener('DOMContentLoaded', () => {
    new MutationObserver(() => { due ||= setTimeout(name, 300); })
      .observe(document.body, { childList: true, subtree: true });
  });
})();
