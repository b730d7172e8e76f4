#!/bin/sh
# Loads the robot description with other programs, in an environment of pinned packages (2 GB).
set -eu
cd "$(dirname "$0")/../.."
PY=${TOOLS_PYTHON:-python3.12}
FOLDER=.venv-tools
[ -x "$FOLDER/bin/python" ] || "$PY" -m venv "$FOLDER"
"$FOLDER/bin/python" -m pip install -q ikpy==4.2.1 drake==1.51.1 mujoco==4.0.0 yourdfpy==0.0.60 \
    urchin==0.0.30 pin==4.1.0
exec "$FOLDER/bin/python" -W ignore tests/genuine_tools/urdf_in_tools.py urdf/so101.urdf
