// Tell the server which tab is in front in the window in control; the scene shows what belongs to it.
(() => {
  const link = window.so101;

  function tell() {
    const { tab: known, press } = link.boards.front ?? {};
    const mine = link.boards.window;
    if (!press || !mine || mine.text) return;  // a window without control shows another's tab
    const tabs = [...document.querySelectorAll('[role="tab"]')];
    const row = tabs.find((tab) => tab.textContent.trim() === 'Program')?.parentElement;
    const front = row && tabs.find(
      (tab) => tab.parentElement === row && tab.getAttribute('aria-selected') === 'true');
    const now = front?.textContent.trim();
    if (now && now !== known) link.send(press, now);
  }

  addEventListener('click', () => setTimeout(tell), true);
  addEventListener('keyup', () => setTimeout(tell), true);
  link.changed.push(tell);
})();
