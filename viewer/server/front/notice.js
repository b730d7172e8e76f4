// Without a graphics card: one line instead of viser's five, outside the picture, and gone by itself.
// A film has no bar: there the line stays in viser's notice.
// And the labels in the picture, which viser draws black on white, are white on black in the dark.
(() => {
  const { shaderSource } = WebGL2RenderingContext.prototype;
  WebGL2RenderingContext.prototype.shaderSource = function (shader, source) {
    const light = !matchMedia('(prefers-color-scheme: dark)').matches;
    shaderSource.call(this, shader, light ? source : source
      .replace('vec4(1.0, 1.0, 1.0, 0.85 * vAlpha)', 'vec4(0.08, 0.08, 0.08, 0.85 * vAlpha)')
      .replace('gl_FragColor = vec4(0.0, 0.0, 0.0, a);', 'gl_FragColor = vec4(1.0, 1.0, 1.0, a);'));
  };

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
