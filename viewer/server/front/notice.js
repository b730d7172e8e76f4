// Without a graphics card: one line instead of viser's five, outside the picture, and gone by itself.
// A film has no bar: there the line stays in viser's notice.
(() => {
  const READ = 12000;  // ms
  const SLOW = 'No graphics card is used, so the picture is slow.';
  let due = 0;

  function shorten() {
    due = 0;
    for (const node of document.querySelectorAll('.mantine-Notification-root:not([data-short])')) {
      node.dataset.short = '';
      if (!node.textContent.startsWith('Software WebGL')) continue;
      const tell = window.so101?.tellReason;
      if (tell) node.style.display = 'none';
      tell?.(SLOW);
      node.querySelector('.mantine-Notification-title').textContent = SLOW;
      node.querySelector('.mantine-Notification-description').textContent = '';
      setTimeout(() => node.querySelector('.mantine-CloseButton-root')?.click(), tell ? 0 : READ);
    }
  }

  addEventListener('DOMContentLoaded', () => {
    new MutationObserver(() => { due ||= setTimeout(shorten, 100); })
      .observe(document.body, { childList: true, subtree: true });
  });
})();
