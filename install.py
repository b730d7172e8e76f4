"""Install the module into ``.venv`` beside this file. ``setup.sh`` finds the Python to run it.

It uses the standard library alone and must never block a machine, so:

* One installation at a time. The process that installs has a lock, which ends with the process;
  another one waits for a while and then says so.
* Everything has a time limit: each connection, the wait for another installation, and the whole.
* A complete installation is left alone, without using the network. ``.venv/.installed`` is written
  last and holds the requirements, so that a new version is noticed.
* It is complete only when all packages can be imported. A missing system library is named with the
  command that installs it; after that, only the imports are tried again.
* The next call repairs an interrupted installation; pip keeps its downloads and builds. An
  environment without pip, or with an unsuitable Python, is made again.
* The free disk space is checked first.

``run.sh`` uses ``--background``, because viam-server ends a module that is not ready in five
minutes, and compiling ruckig may take longer. That installation is a process of its own and writes
to ``setup.log``. The Makefile uses ``--with viewer`` (the page in the browser) or ``--with dev``
(the tests). Where ``wheels/`` came along, as in the archive for arm64, nothing is compiled.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from struct import iter_unpack, unpack_from
from typing import IO

HERE = Path(__file__).resolve().parent
VENV = HERE / ".venv"
PYTHON = VENV / "bin" / "python"
PACKAGES = VENV / ".packages"
"""Written when pip is done."""
DONE = VENV / ".installed"
"""Written when all packages can be imported, too."""
WHEELS = HERE / "wheels"
LOG = HERE / "setup.log"

PATIENCE = 240.0
"""How long a start waits for this installation or another [s]; viam-server allows 300."""
LIMIT = 3000.0
"""Time limit of the whole installation [s]; viam-server allows 3600 for the first run."""
LONGEST_LOG = 100_000
"""A longer log is cleared [byte]."""
COMPILED = ("ruckig",)
"""Packages with ready wheels for some systems only."""
COMPILER = "ziglang"
"""The package that build_native.py requires where no C compiler works."""
READY = (("linux", "x86_64"), ("darwin", "arm64"))
"""Systems with ready wheels of COMPILED: ``sys.platform`` and ``platform.machine()``."""
NETWORK = ("--timeout", "20", "--retries", "3")
"""pip's time limit of a connection [s], and its number of retries."""
NETWORK_SIGNS = ("connection", "retrying", "timed out", "name resolution", "sslerror", "proxyerror")
"""Words in pip's output, in small letters, when it cannot reach the package index."""

VERSIONS = ((3, 11), (3, 14))
"""The oldest and the newest Python with ready wheels; ``setup.sh`` has the same."""
EXTRAS = {
    "viewer": {"viewer"},
    "dev": {"dev", "viewer"},
    "bench": {"bench", "dev", "viewer"},
    "site": {"site"},
}
"""The values of ``--with``, and the extras of ``pyproject.toml`` that each installs."""
MEGABYTES = {"": 680, "viewer": 40, "dev": 550, "bench": 50, "site": 140}
"""The size of the environment and what each extra adds, rounded up; measured."""
REMOVED = 350
"""How much of that ``slim`` removes again [MB]; measured."""
DOWNLOADED = 0.35
"""Size of the wheels as share of the installed size; needed in pip's cache and while it works."""
WITHOUT_COMPILER = 520
"""Additional space for COMPILER during the installation [MB]."""
FULL = 20
"""A disk with less space than this is full [MB]."""


def main(arguments: list[str]) -> int:
    """Install, unless that is done; return the exit code."""
    match arguments:
        case [] | ["--background"]:
            extras = set()
        case ["--with", name] if name in EXTRAS:
            extras = EXTRAS[name]
        case _:
            complain(f"usage: setup.sh [--background | --with {'|'.join(EXTRAS)}]")
            return 2
    if is_installed(extras):
        if not extras:  # make calls this each time
            say(f"installed already, in {VENV}")
        return 0
    return in_background() if arguments == ["--background"] else in_foreground(extras)


def in_foreground(extras: set[str]) -> int:
    """Install and print the progress; return the exit code."""
    with the_lock(PATIENCE) as lock:
        if lock is None:
            complain(
                "another installation is still running; see setup.log if it runs in the background"
            )
            return 1
        return 0 if is_installed(extras) else install(extras, lock)


def in_background() -> int:
    """Install in another process and wait for it for a while; return the exit code."""
    say(f"installing; the progress is written to {LOG}")
    is_long = LOG.exists() and LOG.stat().st_size > LONGEST_LOG
    with LOG.open("w" if is_long else "a") as log:  # another start may be writing to it
        child = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    try:
        code = child.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        say("the installation goes on in the background; the module starts once it is complete")
        return 1
    if code:
        complain("\n".join(LOG.read_text().splitlines()[-15:]))
    return code


def install(extras: set[str], lock: int) -> int:
    """Make the environment, fill it, and try the imports; return the exit code."""
    begin = time.monotonic()
    extras = extras | extras_in(PACKAGES)
    if not is_filled(extras):
        lacking = lacking_space(extras)
        if lacking:
            complain(f"error: {lacking}")
            return 1
        version = platform.python_version()
        size = sum(MEGABYTES[name] for name in ("", *extras))
        say(
            f"installing into {VENV} with Python {version}; this takes minutes, once."
            f" It fills {size} MB, and {size - REMOVED} MB when it is done"
        )
        if not has_ready_wheels():
            say("ruckig has no ready wheel for this system and is compiled")
        for step in steps(extras):
            code, said = run(step, begin + LIMIT - time.monotonic(), lock)
            if code:
                complain(f"error: the installation failed. {what_to_try(said)}")
                return 1
        slim(VENV)
        PACKAGES.write_text(record(extras))
    check = (str(PYTHON), "-m", "so101_motion.common.import_check", *sorted(extras))
    code, _ = run(check, begin + LIMIT - time.monotonic(), lock)
    if code:
        complain("the installation is not complete; repeat it once that is done")
        return 1
    DONE.write_text(record(extras))
    say(f"installed in {time.monotonic() - begin:.0f} s")
    return 0


def steps(extras: set[str]) -> Iterator[tuple[str, ...]]:
    """The commands that make the environment, if there is no usable one, and fill it."""
    if not environment_works():
        yield (sys.executable, "-m", "venv", "--clear", str(VENV))
    from_here = ("--find-links", str(WHEELS)) if WHEELS.is_dir() else ()
    yield (
        *(str(PYTHON), "-m", "pip", "install", "--disable-pip-version-check", "--no-input"),
        # The import check compiles what is used; to tests a compiler's warning would be an error.
        *(() if "dev" in extras else ("--no-compile",)),
        *("--quiet", *NETWORK, *from_here),
        *("--constraint", "constraints.txt"),
        *("--editable", f".[{','.join(sorted(extras))}]" if extras else "."),
    )


def slim(environment: Path) -> None:
    """Remove what only C++ programs, debuggers and the tests of other packages need.

    The wheels of Pinocchio bring the headers of all that it is made of, half of all that is
    installed, each of their libraries twice or thrice, because a wheel has no links, and all of
    Boost, of which they use a third.
    """
    for packages in environment.glob("lib/python3*/site-packages"):
        prefix = packages / "cmeel.prefix"
        for folder in (
            packages / "include",
            *(
                prefix / name
                for name in ("bin", "include", "share/doc", "lib/cmake", "lib/pkgconfig")
            ),
            *(
                folder
                for name in ("numpy", "scipy")
                for folder in packages.glob(f"{name}/**/tests")
            ),
        ):
            shutil.rmtree(folder, ignore_errors=True)
        for file in packages.rglob("*.a"):
            file.unlink()
        for file in packages.rglob("*.so*"):
            if file.is_file() and not file.is_symlink():
                strip(file)
        same: dict[bytes, str] = {}
        for file in sorted(prefix.glob("lib/*.so*")):
            if not file.is_symlink():
                content = hashlib.sha256(file.read_bytes()).digest()
                first = same.setdefault(content, file.name)
                if first != file.name:
                    file.unlink()
                    file.symlink_to(first)
        used = {file: file.read_bytes() for file in prefix.rglob("*.so*") if not file.is_symlink()}
        while unused := [
            file
            for file in prefix.glob("lib/libboost_*.so*")
            if not file.is_symlink()
            and not any(file.name.encode() in used[other] for other in used.keys() - {file})
        ]:
            for file in unused:
                del used[file]
                file.unlink()
        for link in prefix.glob("lib/libboost_*.so*"):
            if not link.exists():
                link.unlink()


def strip(library: Path) -> None:
    """Cut off what follows the segments of a 64-bit ELF file: symbols that only debuggers read.

    It does what ``strip`` does, which a minimal system lacks. Other files are left alone.

    Source: System V Application Binary Interface, chapters 4 (ELF header) and 5 (program header).
    """
    with library.open("r+b") as file:
        header = bytearray(file.read(64))
        if header[:6] != b"\x7fELF\x02\x01":  # of 64 bits, little-endian
            return
        (begin,), (size, count) = unpack_from("<Q", header, 32), unpack_from("<HH", header, 54)
        file.seek(begin)
        segments = iter_unpack("<IIQQQQQQ", file.read(size * count))
        end = max(offset + length for _, _, offset, _, _, length, _, _ in segments)
        header[40:48], header[60:64] = bytes(8), bytes(4)  # there is no table of sections anymore
        file.seek(0)
        file.write(header)
        file.truncate(max(end, begin + size * count))


def run(command: tuple[str, ...], limit: float, lock: int) -> tuple[int, str]:
    """Run a command for at most ``limit`` seconds; return its exit code and its stderr.

    Its child processes end with it. It holds the lock too, in case this process ends before it.
    """
    process = subprocess.Popen(
        command,
        cwd=HERE,
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
        pass_fds=(lock,),
    )
    assert process.stderr is not None
    said: list[str] = []
    reader = threading.Thread(target=pass_on, args=(process.stderr, said), daemon=True)
    reader.start()
    try:
        code = process.wait(max(limit, 0.0))
    except subprocess.TimeoutExpired:
        complain(f"error: stopped, because it was not done after {LIMIT / 60:.0f} minutes")
        code = 1
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    reader.join(5.0)
    return code, "".join(said)


def pass_on(lines: IO[str], said: list[str]) -> None:
    """Print a command's output as it comes, and collect it."""
    with lines:
        for line in lines:
            sys.stderr.write(line)
            sys.stderr.flush()
            said.append(line)


def is_installed(extras: set[str]) -> bool:
    """Whether everything that this version requires is installed and can be imported."""
    is_done = DONE.is_file() and DONE.read_text() == record(extras | extras_in(DONE))
    return is_done and environment_works()


def is_filled(extras: set[str]) -> bool:
    """Whether pip has nothing left to do."""
    return PACKAGES.is_file() and PACKAGES.read_text() == record(extras) and environment_works()


def record(extras: set[str]) -> str:
    """The content of DONE and PACKAGES: the requirements and the extras."""
    return f"{asked_for()}\n# extras: {' '.join(sorted(extras))}\n"


def extras_in(file: Path) -> set[str]:
    """The extras of the installation that wrote this file."""
    text = file.read_text() if file.is_file() else ""
    return set(text.partition("\n# extras: ")[2].split())


def asked_for() -> str:
    """The requirements of this version: the content of the files that determine them."""
    sources = sorted((HERE / "so101_motion" / "native").glob("*.[ch]"))
    asked = (HERE / "pyproject.toml", HERE / "constraints.txt", *sources)
    return "".join(path.read_text() for path in asked)


def environment_works() -> bool:
    """Whether there is a usable environment, with pip and a suitable Python."""
    if not PYTHON.exists():
        return False
    asked = [str(PYTHON), "-m", "pip", "--version"]
    said = subprocess.run(asked, capture_output=True, text=True, check=False).stdout
    found = re.search(r"\(python (\d+)\.(\d+)\)", said)
    if found is None:
        return False
    version = (int(found[1]), int(found[2]))
    if os.environ.get("PYTHON"):  # the user has chosen this one
        return version == sys.version_info[:2]
    return VERSIONS[0] <= version <= VERSIONS[1]


def lacking_space(extras: set[str]) -> str:
    """An error message if a disk has too little free space; empty if all have enough."""
    there = sum(path.lstat().st_size for path in VENV.rglob("*")) / 1e6
    installed = max(sum(MEGABYTES[name] for name in ("", *extras)) - there, 0.0)
    has_one = installed == 0.0 or any(shutil.which(name) for name in ("cc", "gcc", "clang"))
    has_one = has_one or any(HERE.glob(f"so101_motion/native/*-{platform.machine()}.so"))
    compiler = 0.0 if has_one else WITHOUT_COMPILER
    needed: dict[int, tuple[Path, float]] = {}
    cache = Path(os.path.expanduser("~/.cache"))
    for folder, size in (
        (HERE, installed),
        (Path(os.environ.get("TMPDIR", "/tmp")), DOWNLOADED * installed + compiler),
        (cache, DOWNLOADED * installed),
    ):
        place = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if os.access(place, os.W_OK):
            first, before = needed.setdefault(place.stat().st_dev, (place, 0.0))
            needed[place.stat().st_dev] = (first, before + size)
    for place, size in needed.values():
        free = shutil.disk_usage(place).free / 1e6
        if free < size:
            return (
                f"the disk with {place} has {free:.0f} MB free and {size:.0f} MB are needed."
                " try: free some space, then repeat the installation"
            )
    return ""


def has_ready_wheels() -> bool:
    """Whether all wheels exist, so that nothing has to be compiled."""
    python = "-cp311-cp311-" if sys.version_info[:2] == (3, 11) else "-cp312-abi3-"
    shipped = {path.name.split("-")[0] for path in WHEELS.glob(f"*{python}*.whl")}
    return (sys.platform, platform.machine()) in READY or shipped.issuperset(COMPILED)


def what_to_try(said: str) -> str:
    """The cause of a failed installation and what to do, in a sentence or two.

    Args:
        said: The stderr of the failed step.
    """
    free = shutil.disk_usage(HERE).free / 1e6
    if "No space left on device" in said or free < FULL:
        return "The disk is full. try: free some space, then repeat the installation"
    if any(sign in said.lower() for sign in NETWORK_SIGNS):
        return "The package index was not reached; check the network. The next start tries again."
    has_compiler = any(shutil.which(name) for name in ("c++", "g++", "clang++"))
    has_headers = Path(sysconfig.get_path("include"), "Python.h").is_file()
    if has_ready_wheels() or (has_compiler and has_headers):
        return "pip's messages above have the reason. The next start tries again."
    missing = "Python's headers are" if has_compiler else "A C++ compiler is"
    if sys.platform == "darwin":
        return f"{missing} missing. try: xcode-select --install"
    return f"{missing} missing. try: apt-get install g++ cmake python3-dev"


@contextlib.contextmanager
def the_lock(patience: float) -> Iterator[int | None]:
    """Hold the installation lock during the block; None if another installation does not end."""
    with (HERE / ".setup.lock").open("w") as file:
        end = time.monotonic() + patience
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() >= end:
                    yield None
                    return
                time.sleep(0.5)
            else:
                break
        yield file.fileno()


def say(sentence: str) -> None:
    """Print progress on stdout, because viam-server logs stderr as errors."""
    print(f"so101 setup: {sentence}", flush=True)


def complain(sentence: str) -> None:
    """Print a problem on stderr."""
    print(f"so101 setup: {sentence}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
