#!/bin/sh
# Makes dist/module.tar.gz, what the registry hands to machines: build.sh [--wheels]
#
# On x86-64 Linux the archive holds the sources and nothing else; setup.sh installs the rest from
# ready wheels. Elsewhere ruckig may have none, so it is compiled here and goes along in wheels/, for
# the Python that builds; with another Python the machine compiles it itself.
# --wheels does that on x86-64 Linux too.
set -eu

cd -- "$(dirname -- "$0")"
files="meta.json run.sh setup.sh install.py build_native.py MANIFEST.in first_run.sh pyproject.toml
    constraints.txt README.md CHANGELOG.md CONTRIBUTING.md SECURITY.md LICENSE NOTICE docs examples
    benchmarks/README.md so101_motion viewer urdf"

mkdir -p dist
if [ "${1:-}" = --wheels ] || [ "$(uname -s)-$(uname -m)" != Linux-x86_64 ]; then
    ./setup.sh --wheels
    files="$files wheels"
fi
# shellcheck disable=SC2086  # a list of names without blanks
COPYFILE_DISABLE=1 tar -czf dist/module.tar.gz.part \
    --exclude='__pycache__' --exclude='*.pyc' --exclude='*.so' --exclude='*.egg-info' --exclude='.*_cache' $files
mv dist/module.tar.gz.part dist/module.tar.gz
echo "dist/module.tar.gz: $(wc -c <dist/module.tar.gz) bytes"
