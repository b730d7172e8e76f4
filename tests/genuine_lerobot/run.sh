#!/bin/sh
# Makes an environment with the genuine LeRobot and runs its commands on emulated arms: make test-lerobot.
# LeRobot brings PyTorch, some gigabytes; nothing of it runs on a graphics card here.
set -eu
cd -- "$(dirname -- "$0")/../.."
venv=.venv-lerobot
for python in "${LEROBOT_PYTHON:-}" python3.12 python3.13 python3.14 python3; do
    [ -n "$python" ] || continue
    if "$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null; then
        found=$python
        break
    fi
done
if [ -z "${found:-}" ]; then
    echo "make test-lerobot: LeRobot needs Python 3.12 or newer, and there is none here; install one, or name it: LEROBOT_PYTHON=/path/to/python3.12" >&2
    exit 2
fi
if [ ! -x "$venv/bin/lerobot-record" ]; then
    "$found" -m venv "$venv"
    "$venv/bin/pip" install "lerobot[core-scripts,feetech]"
fi
"$venv/bin/pip" install --quiet -e . -e ./lerobot_robot_so101_motion ./tests/genuine_lerobot/lerobot_camera_fake ./tests/genuine_lerobot/lerobot_policy_wild
exec "$venv/bin/python" tests/genuine_lerobot/commands.py "$@"
