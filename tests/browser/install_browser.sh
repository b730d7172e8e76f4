#!/bin/sh
# Makes sure there is a headless browser for the tests: one that is already here, Debian's chromium
# when root, else Playwright's own. Fails with a sentence when none can be had.
set -u
bin=${1:?usage: install_browser.sh path/to/venv/bin}

for name in chromium chromium-browser google-chrome google-chrome-stable; do
    command -v "$name" >/dev/null 2>&1 && exit 0
done
"$bin/python" - <<'PY' && exit 0
import pathlib
import sys

from playwright.sync_api import sync_playwright

with sync_playwright() as p:
    sys.exit(0 if pathlib.Path(p.chromium.executable_path).exists() else 1)
PY
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    echo "installing Debian's chromium for the browser tests"
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq chromium >/dev/null && exit 0
fi
echo "installing Playwright's own chromium for the browser tests"
"$bin/python" -m playwright install chromium && exit 0
echo "error: the browser tests need a browser and none could be installed." >&2
echo "try: install chromium with your package manager, then run make test again" >&2
exit 1
