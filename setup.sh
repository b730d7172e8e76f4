#!/bin/sh
# Installs the module into .venv beside this file. Safe to call at any time and any number of times:
# what is installed already is left alone, and two calls at once wait for each other.
set -eu

cd -- "$(dirname -- "$0")"
for python in "${PYTHON:-}" python3.11 python3.12 python3.13 python3; do
    [ -n "$python" ] || continue
    # Debian ships venv without ensurepip until python3-venv is installed.
    if "$python" -c 'import ensurepip, sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
        exec "$python" install.py "$@"
    fi
done
echo "error: no Python 3.11 or newer with venv was found." >&2
echo "try: apt-get install python3-venv, or set PYTHON to the interpreter to use" >&2
exit 1
