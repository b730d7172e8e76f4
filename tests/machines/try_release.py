"""Build a release twice and install it in every way of ``docs/installation.md``, in empty folders.

    .venv/bin/python tests/machines/try_release.py [--built DIST]

It needs git and the package index, and takes 4 GB of disk for a while. ``--built`` tries the files
in a folder instead of building them.
"""

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from try_machines import megabytes

ROOT = Path(__file__).resolve().parents[2]
DEMO = "demo --text"
ARRIVED = "arrived at (250.0, 120.0, 150.0) mm"
"""What ``so101 demo --text`` says at its end."""


def run(words, cwd, says="", **environment):
    """Run a command; print how long it took; end if it fails, or does not say what it should."""
    begin = time.monotonic()
    done = subprocess.run(
        shlex.split(words),
        cwd=cwd,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    is_good = done.returncode == 0 and says in done.stdout
    print(f"{'ok' if is_good else 'FAILED'}, {time.monotonic() - begin:.0f} s: {words}", flush=True)
    if not is_good:
        sys.exit(done.stdout + "\n0 passed, 1 failed")


def built(folder):
    """A release, built twice in folders of their own; the two have the same bytes."""
    for name in ("one", "two"):
        run(f"git clone --quiet {ROOT} {folder / name}", folder)
        run(f"{sys.executable} release.py", folder / name)
    run("diff --recursive one/dist two/dist", folder)
    return folder / "one" / "dist"


def main():
    """Try everything."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--built", type=Path)
    told = asked.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        empty = folder / "empty"
        empty.mkdir()
        dist = (told.built or built(folder)).resolve()
        (wheel,) = dist.glob("so101_motion-*.whl")
        (sdist,) = dist.glob("so101_motion-*.tar.gz")
        pins = f"--constraint {ROOT / 'constraints.txt'}"
        there = {"PYTHONPATH": ""}

        run(f"{sys.executable} -m venv tools", folder)
        run("tools/bin/pip install --quiet pipx uv", folder, **there)

        run(f"{sys.executable} -m venv pip", folder)
        run(f"pip/bin/pip install --quiet {pins} '{wheel}[viewer]'", folder, **there)
        run(f"../pip/bin/so101 {DEMO}", empty, ARRIVED, **there)
        run(f"pip/bin/pip download --quiet {pins} '{wheel}[viewer]' --dest wheels", folder, **there)
        for name in ("pip", "wheels"):
            print(f"the folder {name} takes {megabytes(folder / name)} MB", flush=True)

        offline = "--no-index --find-links ../wheels"
        run(f"{sys.executable} -m venv offline", folder)
        words = f"../offline/bin/pip install --quiet {offline} 'so101-motion[viewer]'"
        run(words, empty, **there)
        run(f"../offline/bin/so101 {DEMO}", empty, ARRIVED, **there)

        pipx = {**there, "PIPX_HOME": f"{folder}/pipx", "PIPX_BIN_DIR": f"{folder}/bin"}
        run(f"../tools/bin/pipx install '{wheel}[viewer]'", empty, **pipx)
        run(f"../bin/so101 {DEMO}", empty, ARRIVED, **pipx)

        uv = {**there, "UV_CACHE_DIR": f"{folder}/uv", "UV_SYSTEM_CERTS": "1"}
        asked_for = f"--from 'so101-motion[viewer] @ {wheel.as_uri()}'"
        run(f"../tools/bin/uvx {asked_for} so101 {DEMO}", empty, ARRIVED, **uv)

        # No compiler is on this PATH, so pip has to bring one.
        bare = {**there, "PATH": f"{folder}/pip/bin", "CC": ""}
        run(f"../pip/bin/pip wheel --quiet --no-deps {sdist} --wheel-dir ../own", empty, **bare)
        (own,) = (folder / "own").glob("so101_motion-*-linux_*.whl")
        run(f"../pip/bin/pip install --quiet --force-reinstall --no-deps {own}", empty, **there)
        run(f"../pip/bin/so101 {DEMO}", empty, ARRIVED, **there)
    print("1 passed, 0 failed")


if __name__ == "__main__":
    main()
