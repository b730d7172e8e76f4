// Tell the server which tab is in front in the window in control; the scene shows what belongs to it.
// And keep the tabs in front when the window becomes wide or narrow: viser builds its panels anew then.
(() => {
  const link = window.so101;
  const BUILT = 3000;  // ms; until then the new panels must be there
  const narrow = window.matchMedia('(max-width: 1099.98px)');
  let wanted = [];  // tabs that have to be opened in the new panels
  let since = 0;
  let timer = 0;

  const name = (tab) => tab.textContent.trim();
  const isFront = (tab) => tab.getAttribute('aria-selected') === 'true';
  const all = () => [...document.querySelectorAll('[role="tab"]')];

  function tell() {
    const { tab: known, press } = link.boards.front ?? {};
    const mine = link.boards.window;
    const tabs = all();
    const row = tabs.find((tab) => name(tab) === 'Program')?.parentElement;
    const front = row && tabs.find((tab) => tab.parentElement === row && isFront(tab));
    const now = front && name(front);
    document.documentElement.dataset.so101Front = now || '';
    if (wanted.length || !press || !mine || mine.text) return;  // without control: another's tab is shown
    if (now && now !== known) link.send(press, now);
  }

  // In wide windows viser's tabs listen to keys and pointers, in narrow ones to clicks.
  function open(tab) {
    if (tab.tagName === 'BUTTON') tab.click();
    else tab.dispatchEvent(new KeyboardEvent('keydown', { key: 'Enter', bubbles: true }));
  }

  function bring() {
    clearTimeout(timer);
    wanted = wanted.filter(({ called, old }) => {
      const tab = old.isConnected ? null : all().find((each) => name(each) === called);
      if (tab && isFront(tab)) return false;
      if (tab) open(tab);
      return true;
    });
    if (performance.now() - since > BUILT) wanted = [];
    if (wanted.length) timer = setTimeout(bring, 50);
    else tell();
  }

  const leave = (event) => {  // the user chooses another
    if (event.isTrusted) wanted = [];
  };
  addEventListener('pointerdown', leave, true);
  addEventListener('keydown', leave, true);

  narrow.addEventListener('change', () => {
    const now = all().filter((tab) => isFront(tab) && name(tab))
      .map((tab) => ({ called: name(tab), old: tab }));
    const left = wanted.filter(({ called }) => now.every((each) => each.called !== called));
    wanted = [...now, ...left];
    since = performance.now();
    bring();
  });

  addEventListener('click', () => setTimeout(tell), true);
  addEventListener('keyup', () => setTimeout(tell), true);
  link.changed.push(tell);
})();
