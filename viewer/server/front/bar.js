// The bar at the top of every page: what the arm does, its buttons, Stop, and what is wrong.
(() => {
  const link = window.so101;
  const SURE = 700;  // ms until a question may be answered, so that a double click is no answer
  const ASKED = 5000;  // ms for which it is asked
  const READ = 6000;  // ms for which a grey button's reason is shown
  const WATCHES = 'Another window has control: here only STOP works.';
  const board = () => link.boards.bar ?? {};

  const make = (tag, id, parent) => {
    const node = document.createElement(tag);
    if (id) node.id = id;
    if (tag === 'button') node.type = 'button';
    parent?.append(node);
    return node;
  };

  const stop = () => link.send(board().stop, true);

  // Keys. Escape closes an open list first; Space writes where words are written.
  addEventListener('keydown', (event) => {
    const { tagName, type, inputMode, readOnly } = event.target;
    const isField = ['INPUT', 'TEXTAREA', 'SELECT'].includes(tagName);
    const words =
      isField && !readOnly && type !== 'checkbox' && !['numeric', 'decimal'].includes(inputMode);
    if (event.key === 'Escape') {
      if (event.target.getAttribute?.('aria-expanded') !== 'true' || !isField) stop();
    } else if (event.key === ' ' && !words) {
      event.preventDefault();  // else it would press the button that has the focus as well
      event.stopPropagation();
      stop();
    } else if (event.key === 'Enter' && !isField && tagName !== 'BUTTON' && !event.repeat) {
      const due = [...document.querySelectorAll('[data-enter]')].find((node) => node.offsetParent);
      if (due) link.send(due.dataset.enter, true);
    } else if (event.key.toLowerCase() === 'p' && !isField && !event.repeat) {
      if (!event.ctrlKey && !event.metaKey && !event.altKey) link.send(board().plan, true);
    }
  }, true);

  addEventListener('DOMContentLoaded', () => {
    document.documentElement.lang = 'en';
    const bar = make('header', 'so101-bar', document.body);
    const state = make('div', 'so101-state', bar);
    state.setAttribute('role', 'status');
    const mode = make('b', '', state);
    const title = make('small', '', state);
    const buttons = make('div', 'so101-buttons', bar);
    const button = make('button', 'so101-stop', bar);
    button.textContent = 'STOP';
    button.title = 'Space or Escape does the same';
    const views = make('nav', 'so101-views', document.body);
    views.setAttribute('aria-label', 'Views');
    const alerts = make('div', 'so101-alerts', document.body);
    const own = make('div', 'so101-window', alerts);
    const reason = make('div', 'so101-why', alerts);
    reason.setAttribute('role', 'status');
    reason.hidden = true;
    const list = make('div', '', alerts);
    list.setAttribute('role', 'alert');
    const lost = make('div', 'so101-lost', document.body);
    lost.setAttribute('role', 'alert');
    lost.hidden = true;

    const reach = () => { alerts.tabIndex = alerts.scrollHeight > alerts.clientHeight ? 0 : -1; };
    new ResizeObserver(() => {
      document.documentElement.style.setProperty('--so101-wrong', `${alerts.offsetHeight}px`);
      reach();  // what must be scrolled, keys scroll
    }).observe(alerts);

    button.addEventListener('pointerdown', stop);
    button.addEventListener('click', ({ detail }) => { if (!detail) stop(); });  // by a key

    // A grey button that is pressed says why it is grey.
    let read = 0;
    const tellReason = (text) => {
      clearTimeout(read);
      reason.textContent = text;
      reason.hidden = !text;
      if (text) read = setTimeout(tellReason, READ, '');
    };
    link.tellReason = tellReason;

    // Buttons beside Stop: always in their places; some ask first.
    const showButton = ({ label, press, why_not, asks }, k) => {
      const node = buttons.children[k] ?? make('button', '', buttons);
      const why = link.boards.window?.controls === false ? WATCHES : why_not;
      node.disabled = !link.connected;
      node.setAttribute('aria-disabled', String(node.disabled || Boolean(why)));
      node.title = why ?? '';
      if (node.disabled || why || !asks) node.classList.remove('asks');
      if (!node.classList.contains('asks')) node.textContent = label;
      node.onclick = () => {
        tellReason(why ? `${label}: ${why}` : '');
        if (why) return;
        if (asks && !node.classList.contains('asks')) {
          node.classList.add('asks');
          node.textContent = asks;
          node.dataset.since = Date.now();
          setTimeout(() => { node.classList.remove('asks'); show(); }, ASKED);
          return;
        }
        if (asks && Date.now() - node.dataset.since < SURE) return;
        node.classList.remove('asks');
        link.send(press, true);
        show();
      };
    };

    const shown = new Map();
    const changed = (name, value) => {
      const text = JSON.stringify(value ?? null);
      if (shown.get(name) === text) return false;
      shown.set(name, text);
      return true;
    };

    function show() {
      const { state: says = '', title: about = '', alerts: wrong = [] } = board();
      const mine = link.boards.window ?? {};
      const root = document.documentElement;
      if (mode.textContent !== says) mode.textContent = says;
      if (title.textContent !== about) title.textContent = about;
      document.title = about || 'SO-101 motion';
      button.disabled = !link.connected || !board().stop;
      const offered = board().buttons ?? [];
      offered.forEach(showButton);
      [...buttons.children].slice(offered.length).forEach((node) => node.remove());
      root.classList.toggle('so101-empty', !board().so101);
      root.classList.toggle('so101-watching', mine.controls === false);
      if (changed('alerts', wrong)) {
        list.replaceChildren(...wrong.map(({ tone, text }) => {
          const line = make('p');
          line.className = tone;
          line.textContent = text;
          return line;
        }));
        reach();
      }
      if (changed('views', board().views)) {
        views.replaceChildren(...(board().views ?? []).map(({ label, press }) => {
          const view = make('button');
          view.textContent = label;
          view.onclick = () => link.send(press, true);
          return view;
        }));
      }
      if (changed('window', mine)) {
        own.hidden = !mine.text;
        own.replaceChildren(make('span'));
        own.firstChild.textContent = mine.text ?? '';
        for (const { label, press, value } of mine.buttons ?? []) {
          const answer = make('button', '', own);
          answer.textContent = label;
          answer.onclick = () => link.send(press, value);
        }
      }
      if (!board().so101 || link.connected) {
        lost.hidden = true;
        root.classList.remove('so101-lost');
      } else {
        lost.hidden = false;
        root.classList.add('so101-lost');
        tell(link.isExpired ? EXPIRED : TRYING);
      }
    }

    const TRYING =
      'If the program has ended, start it again with the same command: this page then comes back by itself.';
    const EXPIRED =
      'Another page runs here now. Copy its new link from the terminal.';
    let told = '';
    const tell = (more) => {
      if (told === more) return;  // a screen reader says what is new
      told = more;
      lost.replaceChildren(make('b'), make('span'));
      lost.firstChild.textContent = 'No connection: STOP does not work.';
      lost.lastChild.textContent = `Switch off the arm's power supply to stop it; the arm then drops. ${more}`;
    };
    link.changed.push(show);
    show();
  });

  // Buttons in our own pieces of HTML send a value to a widget.
  addEventListener('click', (event) => {
    const button = event.target.closest?.('[data-press]');
    if (button) link.send(button.dataset.press, button.dataset.value);
  });
})();
