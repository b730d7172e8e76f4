#!/bin/sh
# What viam-server starts: run.sh SOCKET [--log-level LEVEL] [--tcp-mode]
#
# Works from a checkout and from an unpacked module archive alike. The first start makes .venv
# beside this file and installs into it; with --install it does only that (see first_run.sh).
# `exec` at the end, so that the process viam-server signals is the module itself.
set -eu

cd -- "$(dirname -- "$0")"
venv="$(pwd)/.venv"

find_python() {
    for python in "${PYTHON:-}" python3.11 python3.12 python3.13 python3; do
        [ -n "$python" ] || continue
        if "$python" -c 'import sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$python"
            return
        fi
    done
    echo "error: no Python 3.11 or newer with venv was found." >&2
    echo "try: apt-get install python3-venv, or set PYTHON to the interpreter to use" >&2
    exit 1
}

install() {
    python=$(find_python)
    echo "installing into $venv; this takes a minute, once" >&2
    [ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
    if ! "$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
        --constraint constraints.txt --editable . >&2; then
        echo "error: the installation failed; is the network there? It is tried again next time." >&2
        exit 1
    fi
}

# pip writes the command last, so its presence means that everything before it is there too.
[ -x "$venv/bin/so101" ] || install
[ "${1:-}" = "--install" ] && exit 0

exec "$venv/bin/python" -m so101_motion "$@"
