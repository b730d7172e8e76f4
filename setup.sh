#!/bin/sh
# Installs the module into .venv beside this file: setup.sh [--with viewer|dev|bench|site]
#
# Safe to call at any time and any number of times: what is installed already is left alone, and two
# calls at once wait for each other. It looks for a Python that suits; PYTHON=... names one.
set -eu

suits='import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))'
version='import sys; print("%d.%d" % sys.version_info[:2])'
without_venv=

install_with() { # python, arguments of install.py; returns only if this Python does not suit
    python=$1
    shift
    "$python" -c "$suits" 2>/dev/null || return 0
    # Debian ships venv without ensurepip until python3-venv is installed.
    if "$python" -c 'import ensurepip' 2>/dev/null; then
        exec "$python" install.py "$@"
    fi
    without_venv=${without_venv:-$python}
}

cd -- "$(dirname -- "$0")"
if [ -n "${PYTHON:-}" ]; then
    install_with "$PYTHON" "$@"
else
    for name in python3.11 python3.12 python3.13 python3.14 python3; do
        install_with "$name" "$@"
    done
fi

if [ -n "$without_venv" ]; then
    found=$("$without_venv" -c "$version")
    echo "error: $without_venv (Python $found) has no venv." >&2
    echo "try: apt-get install python$found-venv (as root)" >&2
    exit 1
fi
wanted=${PYTHON:-python3}
found=$("$wanted" -c "$version" 2>/dev/null) || found=
if [ -n "$found" ]; then
    echo "error: Python 3.11 to 3.14 is needed, and $wanted is Python $found." >&2
    echo "try: install one and name it: PYTHON=/path/to/python3.12 ./setup.sh" >&2
elif [ -n "${PYTHON:-}" ]; then
    echo "error: Python 3.11 to 3.14 is needed, and PYTHON=$PYTHON cannot be run." >&2
    echo "try: without PYTHON, to look for one; or name another" >&2
else
    echo "error: no Python 3.11 to 3.14 was found." >&2
    echo "try: apt-get install python3-venv (as root)" >&2
fi
exit 1
