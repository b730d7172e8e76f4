#!/usr/bin/env python3
"""Try a release on emulated minimal Debian machines of arm64, and record what happened.

Needs root on a Debian, the network, and ``apt-get install mmdebstrap qemu-user-static``; ``make
check-arm64`` makes the release and calls this. qemu emulates the processor: everything takes ten
times as long and more, so figures of time say little about a Raspberry Pi.

What a Pi's owner types runs on the emulated processor: the environment, ``setup.sh`` with its
imports, ``so101 demo --text``, ``run.sh``, a part of the tests. Three things would take hours there
and are done by the machine that emulates, and the rows say so: Debian's packages are unpacked, pip
chooses and unpacks the wheels for arm64 (it compiles nothing: sources are forbidden), and the
client of the module asks for twelve moves.

The wheel is installed by the words of ``docs/installation.md`` for a computer without the network:
the folder of wheels is filled by the machine that emulates, pip runs on the emulated processor.

What came of each line goes to ``benchmarks/results/machines.json``, to the table of
``benchmarks/README.md`` and to the terminal.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from pathlib import Path

from try_machines import (
    CA_BUNDLE,
    RELEASES,
    RESULT,
    ROOT,
    Machine,
    StoppedError,
    archive,
    arrives,
    committed,
    done,
    megabytes,
    passed,
    shown_lines,
    write,
)

sys.path.insert(0, str(ROOT / "tests"))

PYTHONS = {"bookworm": "3.11", "trixie": "3.13"}
DIST = ROOT / "dist"
FOLDER = "/root/so101_motion"
ALWAYS = ["base-files", "base-passwd", "coreutils", "dash", "grep", "libstdc++6", "sed"]
"""What every Debian has of what is used; nothing is unpacked but what is asked for."""
TESTS = (
    "tests/unit/planning/kinematics tests/unit/planning/timing/test_online.py "
    "tests/unit/common/test_geometry.py"
)
TESTERS = ("pytest", "pytest-asyncio", "pytest-timeout", "pytest-xdist", "hypothesis")
MOVES = [(x, y, z) for x in (180, 250) for y in (-80, 0, 80) for z in (100, 180)]
ARRIVED = 0.2
"""How far from the goal a move may end [mm]; the emulator computes as exactly as a processor."""
PATIENCE = 10_800.0
"""Nothing takes as long, also where others compute [s]."""


def make(root: Path, release: str, packages: list[str]) -> None:
    """Unpack Debian and packages for arm64; nothing in it has run."""
    source = f"deb {archive()} {release} main"
    which = ("--mode=root", "--variant=extract", "--arch=arm64")
    command = ["mmdebstrap", *which, f"--include={','.join(ALWAYS + packages)}"]
    subprocess.run([*command, release, str(root), source], check=True, stdout=subprocess.DEVNULL)
    for name in ("passwd", "group"):
        shutil.copy(root / "usr/share/base-passwd" / f"{name}.master", root / "etc" / name)
    certificates = root / CA_BUNDLE.relative_to("/")  # pip of Debian 13 opens it, also offline
    certificates.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(CA_BUNDLE, certificates)


def pip(release: str, site: Path, *asked: str) -> None:
    """Unpack the wheels for arm64 that pip would choose there, into a folder."""
    version = PYTHONS[release]
    platforms = "--platform=manylinux_2_28_aarch64", "--platform=manylinux2014_aarch64"
    python = f"--python-version={version}", "--implementation=cp", "--only-binary=:all:"
    abis = f"--abi=cp{version.replace('.', '')}", "--abi=abi3", "--abi=none"
    where = "--target", str(site), "--constraint", "constraints.txt"
    words = "-m pip install --quiet --no-compile --upgrade"
    command = [sys.executable, *words.split(), *platforms, *python, *abis]
    subprocess.run([*command, *where, *asked], cwd=ROOT, check=True)


def fill(machine: Machine, release: str) -> None:
    """What ``pip install .`` does on a Pi, from the wheels that came in the archive."""
    folder = machine.root / FOLDER.lstrip("/")
    site = folder / ".venv/lib" / f"python{PYTHONS[release]}" / "site-packages"
    with tempfile.TemporaryDirectory() as name:
        tree = shutil.copytree(folder, Path(name, "tree"), ignore=shutil.ignore_patterns(".venv"))
        build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", name, "."]
        subprocess.run(build, cwd=tree, check=True)
        (ours,) = Path(name).glob("so101_motion-*.whl")
        pip(release, site, "--find-links", str(folder / "wheels"), str(ours))
    so101 = folder / ".venv/bin/so101"
    said = (site / "bin" / "so101").read_text().partition("\n")[2]
    so101.write_text(f"#!{FOLDER}/.venv/bin/python\n{said}")
    so101.chmod(0o755)


def try_archive(machine: Machine, release: str) -> None:
    folder = machine.root / FOLDER.lstrip("/")
    folder.mkdir()
    with tarfile.open(DIST / "module-linux-arm64.tar.gz") as tar:
        tar.extractall(folder, filter="tar")
    machine.expect("python3 -m venv .venv", done, folder=FOLDER)
    begin = time.monotonic()
    fill(machine, release)
    seconds = time.monotonic() - begin
    machine.note("pip install . (not emulated)", "done; nothing was compiled", "", seconds)
    filled = "import install as i; i.slim(i.VENV); i.PACKAGES.write_text(i.record(set()))"
    machine.type(f'python3 -c "{filled}"', folder=FOLDER)
    machine.expect("./setup.sh", done, folder=FOLDER, shown="./setup.sh (the rest: the imports)")
    size = megabytes(folder / ".venv")
    machine.note("(disk: .venv of the module)", f"{size} MB", "", 0.0)
    machine.expect(".venv/bin/so101 demo --text", arrives, folder=FOLDER)
    asyncio.run(try_moves(machine))
    for name in ("tests", "benchmarks"):
        shutil.copytree(ROOT / name, folder / name, dirs_exist_ok=True)
    site = folder / ".venv/lib" / f"python{PYTHONS[release]}" / "site-packages"
    pip(release, site, *TESTERS)
    line = f".venv/bin/python -m pytest -q -o timeout=0 {TESTS}"
    machine.expect(line, passed, folder=FOLDER)
    size = megabytes(machine.root)
    machine.note("(disk: the whole machine)", f"{size} MB", "", 0.0)


def try_wheel(machine: Machine, release: str) -> None:
    """What the page on installation says for a computer without the network."""
    (wheel,) = DIST.glob("so101_motion-*.whl")
    begin = time.monotonic()
    page = (ROOT / "docs/installation.md").read_text()
    line = next(line for line in page.splitlines() if "_aarch64" in line and line.startswith("$ "))
    line = line[2:].replace("WHEEL", str(wheel)).replace("3.11", PYTHONS[release])
    line = line.replace("-d wheels", f"-d {machine.root}/root/wheels")
    words = ("-m", *shlex.split(line), "--quiet", "--constraint", "constraints.txt")
    subprocess.run([sys.executable, *words], cwd=ROOT, check=True)
    seconds = time.monotonic() - begin
    machine.note("pip download ... (not emulated)", "done; nothing was compiled", "", seconds)
    machine.expect("python3 -m venv own", done)
    line = 'pip install --no-index --find-links wheels "so101-motion[viewer]"'
    assert f"$ {line}\n" in page
    machine.expect(f". own/bin/activate && {line}", done, shown=line)
    machine.note("(disk: the environment)", f"{megabytes(machine.root / 'root/own')} MB", "", 0.0)
    machine.expect("own/bin/so101 demo --text", arrives)


async def try_moves(machine: Machine) -> None:
    """Twelve moves of a simulated arm through the module's process, by a client outside."""
    from harness.fake_parent import ARM, SIMULATED, running_module
    from viam.components.arm import Pose

    begin = time.monotonic()
    *_, script, zero = machine.command('exec ./run.sh "$@"', FOLDER, "root")
    # One process from here to the module, which is the one that is asked to end.
    command = ("unshare", "--mount", "sh", "-c", script, zero)
    arrived, first = 0, 0.0
    async with running_module(command=command, patience=PATIENCE) as (module, _, ready):
        arm = await module.add(ARM, SIMULATED, {"acceleration_degs_per_sec_per_sec": 500.0}, "arm")
        for x, y, z in MOVES:
            await arm.move_to_position(Pose(x=x, y=y, z=z, o_z=1))
            first = first or time.monotonic() - begin
            at = await arm.get_end_position()
            arrived += max(abs(at.x - x), abs(at.y - y), abs(at.z - z)) <= ARRIVED
    said = f"{arrived} of {len(MOVES)} moves arrived within {ARRIVED} mm"
    told = f"{said}; ready after {ready:.0f} s, the first arrived after {first:.0f} s"
    seconds = time.monotonic() - begin
    verdict = told if arrived == len(MOVES) else ""
    machine.note("./run.sh SOCKET; twelve moves (client not emulated)", verdict, told, seconds)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--release", action="append", choices=RELEASES, help="default: both")
    parser.add_argument("--part", action="append", choices=("archive", "wheel"))
    parser.add_argument("--work", type=Path, default=Path("/tmp/so101-arm64"))
    parser.add_argument("--result", type=Path, default=RESULT)
    given = parser.parse_args()
    if os.geteuid() != 0 or not all(map(shutil.which, ("mmdebstrap", "qemu-aarch64-static"))):
        sys.exit("this needs root. try: apt-get install mmdebstrap qemu-user-static binfmt-support")
    os.nice(15)
    parts = {"archive": try_archive, "wheel": try_wheel}
    rows = []
    for release in given.release or RELEASES:
        root = given.work / release
        shutil.rmtree(root, ignore_errors=True)
        sockets = given.work / "sockets"
        sockets.mkdir(parents=True, exist_ok=True)
        tempfile.tempdir = str(sockets)
        begin = time.monotonic()
        (line, *_) = [line for is_root, line in shown_lines("make demo") if is_root]
        make(root, release, line.removeprefix("apt-get install ").split())
        (root / sockets.relative_to("/")).mkdir(parents=True)
        seconds = time.monotonic() - begin
        for part in given.part or parts:
            name = f"{RELEASES[release]}, emulated arm64"
            machine = Machine(root, name, "root", f"{part}, root", [], sockets, PATIENCE)
            machine.note(f"{line} (unpacked, not emulated)", "done", "", seconds)
            with contextlib.suppress(StoppedError):
                parts[part](machine, release)
            rows += machine.rows
            write(given.result, machine.rows, committed())
        shutil.rmtree(root)
    return 0 if all(row.ok for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
