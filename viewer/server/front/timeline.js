// The timeline of a rehearsed program: a mouse or a finger on it moves the ghost.
(() => {
  const link = window.so101;
  let line = null;  // the one that is held

  function show() {
    const { t = null } = link.boards.program ?? {};
    for (const mark of document.querySelectorAll('.so101-timeline u')) {
      mark.hidden = t === null;
      mark.style.left = `${(100 * t) / Number(mark.parentElement.dataset.duration)}%`;
    }
  }

  function seek(event) {
    const { left, width } = line.getBoundingClientRect();
    const share = Math.max(0, Math.min(1, (event.clientX - left) / width));
    link.enter(line.dataset.seek, Math.round(100 * share * Number(line.dataset.duration)) / 100);
  }

  addEventListener('pointerdown', (event) => {
    const found = event.target.closest?.('.so101-timeline[data-seek]');
    if (!found || event.button !== 0) return;
    line = found;
    seek(event);
  }, true);
  addEventListener('pointermove', (event) => { if (line) seek(event); }, true);
  for (const end of ['pointerup', 'pointercancel']) addEventListener(end, () => { line = null; }, true);

  link.changed.push(show);
})();
