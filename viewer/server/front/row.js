// Grey single buttons of a row, which viser cannot. One that is pressed says why it is grey. And mark
// the widgets that every window may use.
(() => {
  const link = window.so101;
  const GREY = '.mantine-Button-root[aria-disabled="true"]';
  let due = 0;

  function buttonsOf(row) {
    let around = document.querySelector(`label[for="${row}"]`);
    while (around && !around.querySelector('.mantine-Button-root')) around = around.parentElement;
    return around?.querySelectorAll('.mantine-Button-root') ?? [];
  }

  function show() {
    due = 0;
    for (const id of link.boards.window?.open ?? []) {
      document.getElementById(id)?.toggleAttribute('data-open', link.connected);
    }
    for (const { row, why_not } of Object.values(link.boards)) {
      if (!row) continue;
      for (const button of buttonsOf(row)) {
        const why = why_not[button.textContent] ?? '';
        button.title = why;
        button.setAttribute('aria-disabled', String(Boolean(why)));
      }
    }
  }

  const soon = () => { due ||= setTimeout(show, 50); };
  link.changed.push(soon);
  addEventListener('DOMContentLoaded', () => {
    new MutationObserver(soon).observe(document.body, { childList: true, subtree: true });
  });

  addEventListener('click', (event) => {
    const button = event.target.closest?.(GREY);
    if (!button) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    link.tellReason?.(`${button.textContent}: ${button.title}`);
  }, true);
})();
