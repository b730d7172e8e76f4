#!/bin/sh
# Writes 64 data sets with four genuine releases of LeRobot and checks them: make test-data-sets.
# One environment has LeRobot's newest of them with PyTorch, some gigabytes; the others lie beside it.
set -eu
cd -- "$(dirname -- "$0")/../.."
python="${LEROBOT_PYTHON:-python3.12}"
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
venv=.venv-lerobot/data-sets
if [ ! -d "$venv/0.4.4" ]; then
    "$python" -m venv "$venv"
    "$venv/bin/pip" install "lerobot[core-scripts,feetech]==0.6.1" accelerate jsonlines
    for version in 0.3.3 0.4.2 0.4.4; do
        "$venv/bin/pip" install --no-deps --target "$venv/$version" "lerobot==$version"
    done
fi
ours="${SO101_PYTHON:-.venv/bin/python}"
"$ours" tests/genuine_lerobot/data_sets.py plan "$folder"
for version in 0.3.3 0.4.2 0.4.4 0.6.1; do
    HF_HUB_OFFLINE=1 PYTHONPATH="$venv/$version" "$venv/bin/python" tests/genuine_lerobot/data_sets.py make "$folder" "$version"
done
"$ours" tests/genuine_lerobot/data_sets.py check "$folder"
