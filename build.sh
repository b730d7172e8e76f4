#!/bin/sh
# Makes the archive that the registry hands to machines: build.sh [linux/arm64]
#
# dist/module.tar.gz holds the sources and nothing else; setup.sh installs the rest from ready wheels.
# For Linux on arm64, ruckig has none, and a Raspberry Pi shall compile nothing: the archive for it
# has wheels of ruckig and the library of planning besides, made by build_wheels.py on whatever
# machine this runs. Asked for by name it is dist/module-linux-arm64.tar.gz.
set -eu

cd -- "$(dirname -- "$0")"
files="meta.json run.sh setup.sh install.py build_native.py MANIFEST.in first_run.sh pyproject.toml
    constraints.txt README.md CHANGELOG.md CONTRIBUTING.md SECURITY.md LICENSE NOTICE docs examples
    benchmarks/README.md so101_motion viewer urdf"

mkdir -p dist
archive=dist/module${1:+-linux-arm64}.tar.gz
without='*.so'
case ${1:-$(uname -s)-$(uname -m)} in
    linux/arm64 | Linux-aarch64)
        "${PYTHON:-python3}" build_wheels.py
        files="$files wheels"
        without='*x86_64.so'
        ;;
    Linux-* | Darwin-*) ;;
    *)
        echo "error: $1 has no archive of its own. try: build.sh, or build.sh linux/arm64" >&2
        exit 2
        ;;
esac
# shellcheck disable=SC2086  # a list of names without blanks
COPYFILE_DISABLE=1 tar -czf "$archive.part" \
    --exclude='__pycache__' --exclude='*.pyc' --exclude="$without" --exclude='*.egg-info' --exclude='.*_cache' $files
mv "$archive.part" "$archive"
echo "$archive: $(wc -c <"$archive") bytes"
