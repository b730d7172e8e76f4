// Connect our own front end with the server, over viser's connection.
//
// That connection lives in a worker. We read what the worker sends to viser, and hand it messages of our
// own, so Stop needs neither React nor a picture. The server sends its side as JSON in invisible
// pieces of HTML: the boards.
(() => {
  const MARK = '{"so101":';
  const SILENT = 3500;  // ms; the server says something every second
  const PATIENCE = 6000;  // ms; viser gives an attempt up after five
  const stock = window.matchMedia.bind(window);
  const dark = stock('(prefers-color-scheme: dark)');
  const link = (window.so101 = { connected: false, isExpired: false, boards: {}, changed: [] });
  const boards = new Map();  // by the id of the widget that holds it
  let worker = null;
  let theme = null;
  let heard = 0;
  let silent = 0;

  function publish() {
    link.boards = {};
    for (const board of boards.values()) link.boards[board.so101] = board;
    for (const tell of link.changed) tell();
  }

  function take(message) {
    if (message.type === 'ThemeConfigurationMessage') {  // the system decides, not the server
      theme = message;
      theme.dark_mode = dark.matches;
      document.documentElement.dataset.so101Themed = '';
      return false;
    }
    const content = message.props?.content ?? message.updates?.content;
    if (message.type === 'GuiRemoveMessage') return boards.delete(message.uuid);
    if (typeof content !== 'string' || !content.startsWith(MARK)) return false;
    boards.set(message.uuid, JSON.parse(content));
    return true;
  }

  function hear(from, data) {
    if (data?.type === 'connected') {
      worker = from;
      boards.clear();
    } else if (data?.type === 'message_batch') {
      heard = performance.now();
      silent = 0;
      const was = link.connected;
      link.connected = true;
      if (data.messages.filter(take).length || !was) publish();
    } else if (data?.type === 'closed') {
      link.connected = false;
      publish();
    }
  }

  const Stock = window.Worker;
  window.Worker = class extends Stock {
    constructor(...how) {
      super(...how);
      this.addEventListener('message', ({ data }) => hear(this, data));
    }

    postMessage(message, ...rest) {
      const post = () => super.postMessage(message, ...rest);
      if (message?.type === 'retry') retry(post); else post();
    }
  };

  // viser begins another attempt every second, which ends the one before. After some sixty that failed a
  // browser delays each by up to five, so none would ever succeed. So nothing is tried before the server
  // answers, and then each attempt has its time.
  let tried = -Infinity;
  let asks = false;

  async function retry(again) {
    if (asks || performance.now() - tried < PATIENCE) return;
    asks = true;
    try {
      const reply = await fetch('/', { cache: 'no-store', signal: AbortSignal.timeout(3000) });
      reply.body?.cancel();
      link.isExpired = reply.status === 401;
      if (reply.ok) {
        tried = performance.now();
        again();
      }
    } catch { link.isExpired = false; }
    asks = false;
    publish();
  }

  // Twice in a row, because a busy browser gets messages late.
  setInterval(() => {
    if (!link.connected) {
      // viser tries again only while its window has the focus.
      if (worker && !document.hasFocus()) worker.postMessage({ type: 'retry' });
    } else if (performance.now() - heard > SILENT && ++silent > 1) {
      link.connected = false;
      publish();
    }
  }, 1000);

  link.send = (uuid, value) => {
    if (!worker || !uuid) return;
    const message = { type: 'GuiUpdateMessage', uuid, updates: { value } };
    worker.postMessage({ type: 'send', message });
  };

  // The same, and the widget shows it: viser tells every window but the one that sent it.
  link.enter = (uuid, value) => {
    if (!link.connected || !uuid) return;
    link.send(uuid, value);
    const messages = [{ type: 'GuiUpdateMessage', uuid, updates: { value } }];
    worker.onmessage({ data: { type: 'message_batch', messages } });
  };

  // The phone's layout is viser's for narrow windows; ours begins at a width of our own.
  window.matchMedia = (query) =>
    stock(query === '(max-width: 36em)' ? '(max-width: 1099.98px)' : query);

  dark.addEventListener('change', () => {
    if (!theme) return;
    const messages = [{ ...theme, dark_mode: dark.matches }];
    worker.onmessage({ data: { type: 'message_batch', messages } });
  });

  const here = new URL(location);
  if (here.searchParams.has('darkMode')) {  // would keep viser dark for good
    here.searchParams.delete('darkMode');
    history.replaceState(null, '', here);
  }
})();
