// Without a graphics card: one line instead of viser's five, and gone by itself. A film has it, too.
(() => {
  const READ = 12000;  // ms
  let due = 0;

  function shorten() {
    due = 0;
    for (const node of document.querySelectorAll('.mantine-Notification-root:not([data-short])')) {
      node.dataset.short = '';
      if (!node.textContent.startsWith('Software WebGL')) continue;
      node.querySelector('.mantine-Notification-title').textContent =
        'No graphics card is used, so the picture is slow.';
      node.querySelector('.mantine-Notification-description').textContent = '';
      setTimeout(() => node.querySelector('.mantine-CloseButton-root')?.click(), READ);
    }
  }

  addEventListener('DOMContentLoaded', () => {
    new MutationObserver(() => { due ||= setTimeout(shorten, 100); })
      .observe(document.body, { childList: true, subtree: true });
  });
})();
