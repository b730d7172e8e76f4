// A press hides the tooltips: they would cover what is needed next. And a tooltip stays open when what it is
// about becomes grey or goes away under the mouse, because the browser then never says that the mouse left.
(() => {
  const root = document.documentElement;
  let pressed = null;
  const hideOpen = () => document.querySelectorAll('.mantine-Tooltip-tooltip').forEach((node) => {
    node.style.setProperty('display', 'none', 'important');
  });

  addEventListener('pointerdown', ({ target }) => {
    hideOpen();
    pressed = target.closest?.('button, label, [role="tab"]') ?? target;
    root.classList.add('so101-pressed');  // nor does one open late over what was pressed
  }, true);
  addEventListener('pointerover', ({ target }) => {
    if (!pressed || pressed.contains(target)) return;
    hideOpen();
    pressed = null;
    root.classList.remove('so101-pressed');
  }, true);
})();
