"""Add our style and script to the ``<head>`` of viser's page.

They follow the browser's dark scheme, colour our pieces of HTML, make Escape stop even while a
field has the focus (and Space in fields without words), and keep a Stop button in sight on
phones, where panels are folded away. Nothing is loaded from the network.
"""

from __future__ import annotations

import gzip
from functools import lru_cache

from websockets.http11 import Response

NARROW = "36em"
"""Width below which viser shows its phone layout; its ``breakpoints.xs``."""

_STYLE = f"""
:root {{ --so101-good: #237a36; --so101-bad: #c92a2a; --so101-warm: #b35c00; }}
:root[data-mantine-color-scheme="dark"] {{
  --so101-good: #69db7c; --so101-bad: #ff8787; --so101-warm: #ffc078;
}}
#so101-stop, .so101-narrow {{ display: none; }}
@media (max-width: {NARROW}) {{
  .so101-narrow {{ display: block; position: fixed; top: 12px; left: 4px; max-width: 55%; }}
  #so101-stop {{
    display: block; position: fixed; z-index: 1000; top: 12px; right: 12px;
    width: 132px; height: 56px; border: 0; border-radius: 8px; cursor: pointer;
    background: #e03131; color: #fff; font: 700 20px system-ui, sans-serif;
    box-shadow: 0 2px 8px #0006; touch-action: manipulation;
  }}
  #so101-stop:active {{ background: #a51111; }}
  .uplot {{ max-width: calc(100vw - 2.4em); overflow: hidden; }}
  .mantine-Paper-root[style*="20em"], .mantine-Paper-root[style*="20em"] [style*="width: 20em"] {{
    width: 100% !important;
  }}
}}
"""

_SCRIPT = """
(() => {
  const dark = matchMedia('(prefers-color-scheme: dark)').matches;
  const here = new URL(location);
  if (dark !== here.searchParams.has('darkMode')) {
    if (dark) here.searchParams.set('darkMode', ''); else here.searchParams.delete('darkMode');
    history.replaceState(null, '', here);
  }
  const press = (key, code) => document.documentElement.dispatchEvent(
    new KeyboardEvent('keydown', { key, code, bubbles: true }));
  addEventListener('keydown', (event) => {
    const { tagName, type, inputMode, readOnly } = event.target;
    if (!['INPUT', 'TEXTAREA', 'SELECT'].includes(tagName)) return;
    const words = !readOnly && type !== 'checkbox' && !['numeric', 'decimal'].includes(inputMode);
    if (event.key === 'Escape' || (event.key === ' ' && !words)) press(event.key, event.code);
  }, true);
  addEventListener('DOMContentLoaded', () => {
    document.title = 'SO-101 motion';
    const stop = document.createElement('button');
    stop.id = 'so101-stop';
    stop.textContent = 'STOP';
    stop.addEventListener('pointerdown', () => press(' ', 'Space'));
    document.body.append(stop);
  });
})();
"""

_HEAD = f"<head><style>{_STYLE}</style><script>{_SCRIPT}</script>".encode()


def add_head(reply: Response) -> None:
    """Put our beginning into ``reply`` if it is a page; anything else stays as it is."""
    if reply.status_code != 200 or "text/html" not in reply.headers.get("Content-Type", ""):
        return
    zipped = reply.headers.get("Content-Encoding") == "gzip"
    reply.body = _dressed(bytes(reply.body), zipped)
    del reply.headers["Content-Length"]
    reply.headers["Content-Length"] = str(len(reply.body))


@lru_cache(maxsize=2)  # one page, plain and compressed
def _dressed(page: bytes, zipped: bool) -> bytes:
    plain = gzip.decompress(page) if zipped else page
    begun = plain.replace(b"<head>", _HEAD, 1)
    return gzip.compress(begun) if zipped else begun
