#!/bin/sh
# Makes sure there is a headless browser for the tests: one that is already here, Debian's chromium
# when root, else Playwright's own. Fails with a sentence when none can be had.
set -u
bin=${1:?usage: install_browser.sh path/to/venv/bin}

has_browser() {
    for name in chromium chromium-browser google-chrome google-chrome-stable; do
        command -v "$name" >/dev/null 2>&1 && return 0
    done
    "$bin/python" - <<'PY'
import pathlib
import sys

from playwright.sync_api import sync_playwright

with sync_playwright() as p:
    sys.exit(0 if pathlib.Path(p.chromium.executable_path).exists() else 1)
PY
}

install() { # packages of Debian; fails when they cannot be installed here
    [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1 || return 1
    echo "installing $* for the browser tests"
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "$@" >/dev/null
}

# Playwright drives every browser through a node of its own, which a minimal Debian cannot start.
said=$("$bin/python" -m playwright --version 2>&1)
case $said in
*libatomic.so.1*)
    if ! install libatomic1; then
        echo "error: the browser tests need libatomic.so.1 and a browser." >&2
        echo "try: apt-get install libatomic1 chromium (as root), then run make test again" >&2
        exit 1
    fi
    ;;
esac
has_browser && exit 0
install chromium && exit 0
echo "installing Playwright's own chromium for the browser tests"
"$bin/python" -m playwright install chromium && exit 0
echo "error: the browser tests need a browser and none could be installed." >&2
echo "try: apt-get install chromium (as root), then run make test again" >&2
exit 1
