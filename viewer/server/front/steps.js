// Drag the rows of waypoints into another order (with a finger, by their numbers), and keep the
// chosen row in sight.
(() => {
  const link = window.so101;
  const FAR = 6;  // px until it is a drag, and no click
  const EDGE = 14;  // px at either end of the list where it scrolls
  let row = null;
  let start = 0;
  let over = null;
  let count = 0;

  const rowAt = (event) =>
    document.elementFromPoint(event.clientX, event.clientY)?.closest('.so101-steps button');
  const place = (button) => [...button.parentElement.children].indexOf(button);

  function end() {
    row = null;
    over?.classList.remove('over');
    over = null;
  }

  addEventListener('pointerdown', (event) => {
    const found = event.target.closest?.('.so101-steps[data-move] button');
    if (!found || event.button !== 0) return;
    if (event.pointerType === 'touch' && !event.target.closest('i')) return;  // fingers scroll
    [row, start] = [found, event.clientY];
  }, true);

  addEventListener('pointermove', (event) => {
    if (!row || (!over && Math.abs(event.clientY - start) < FAR)) return;
    const found = rowAt(event);
    over?.classList.remove('over');
    over = found ?? row;
    over.classList.add('over');
    const list = over.parentElement?.parentElement;
    if (!list) return;
    const { top, bottom } = list.getBoundingClientRect();
    list.scrollTop += event.clientY < top + EDGE ? -EDGE : event.clientY > bottom - EDGE ? EDGE : 0;
  }, true);

  addEventListener('pointerup', () => {
    if (row && over) {
      const list = row.parentElement ?? over.parentElement;
      const swallow = (click) => click.stopPropagation();  // a mouse clicks now, a finger does not
      addEventListener('click', swallow, true);
      setTimeout(() => removeEventListener('click', swallow, true), 50);
      const [from, to] = [Number(row.dataset.value) - 1, place(over)];
      if (from !== to && list) link.send(list.dataset.move, `${++count} ${from} ${to}`);
    }
    end();
  }, true);
  addEventListener('pointercancel', end, true);

  let shown = '';  // the row that was chosen last
  function follow() {
    const chosen = document.querySelector('.so101-steps .chosen');
    const now = chosen ? chosen.dataset.value : '';
    if (now === shown) return;
    shown = now;
    const list = chosen?.parentElement.parentElement;  // not scrollIntoView: the panel stays
    if (!list) return;
    const [top, bottom] = [chosen.offsetTop, chosen.offsetTop + chosen.offsetHeight];
    list.scrollTop = Math.min(Math.max(list.scrollTop, bottom - list.clientHeight), top);
  }
  addEventListener('DOMContentLoaded', () => {
    new MutationObserver(follow).observe(document.body, { childList: true, subtree: true });
  });
})();
