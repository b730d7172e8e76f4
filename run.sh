#!/bin/sh
# What viam-server starts: run.sh SOCKET [--log-level LEVEL] [--tcp-mode]
#
# Works from a checkout and from an unpacked module archive alike. Once installed it goes straight
# to the module and asks the network for nothing. Where first_run.sh has not run, the installation
# is started here; viam-server gives a start five minutes, so it goes on in the background and
# later starts wait for the same one.
# `exec` at the end, so that the process viam-server signals is the module itself.
set -eu

cd -- "$(dirname -- "$0")"

# Written last, once everything that is needed could be imported.
[ -f .venv/.installed ] && [ -x .venv/bin/python ] || ./setup.sh --background

exec .venv/bin/python -m so101_motion "$@"
