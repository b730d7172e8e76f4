"""Installs the module into ``.venv`` beside this file. ``setup.sh`` finds the Python to run it.

It uses the standard library alone and must never hold a machine up, so:

* One installation at a time. The lock belongs to the process that installs and ends with it,
  however it ends; whoever comes meanwhile waits a while and then says so.
* Everything has a limit: each connection, the wait for another installation, and the whole.
* What is complete is left alone, without a word to the network. ``.venv/.installed`` is written
  last and holds what was asked for, so that a new version is noticed.
* What was cut short is repaired by the next call; pip keeps what it has downloaded and built.

``run.sh`` asks for ``--background`` because viam-server ends a module that is not ready in five
minutes, and where ruckig and toppra have to be compiled it takes longer. That installation is a
process of its own and writes to ``setup.log``. ``build.sh`` asks for ``--wheels`` so that those
two come along compiled; with them nothing is compiled on the machine.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import platform
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).resolve().parent
VENV = HERE / ".venv"
PYTHON = VENV / "bin" / "python"
DONE = VENV / ".installed"
WHEELS = HERE / "wheels"
LOG = HERE / "setup.log"

PATIENCE = 240.0
"""How long a start waits, for this installation or for another [s]; viam-server gives it 300."""
LIMIT = 3000.0
"""The whole installation [s]; viam-server gives the first run 3600."""
LONGEST_LOG = 100_000
"""Bytes after which the log is begun anew."""
COMPILED = ("ruckig", "toppra")
"""What has ready wheels for some systems only."""
NETWORK = ("--timeout", "20", "--retries", "3")
"""For one connection [s], and how often it is tried again."""


def main(arguments: list[str]) -> int:
    """Install, unless that is done; the exit code."""
    if arguments not in ([], ["--background"], ["--wheels"]):
        say("usage: setup.sh [--background | --wheels]")
        return 2
    if arguments == ["--wheels"]:
        return compile_wheels()
    if is_installed():
        say(f"installed already, in {VENV}")
        return 0
    return in_background() if arguments else in_foreground()


def in_foreground() -> int:
    """Install, and say how it goes; the exit code."""
    with the_lock(PATIENCE) as lock:
        if lock is None:
            say("another installation is still running; see setup.log if it runs in the background")
            return 1
        return 0 if is_installed() else install(lock)


def in_background() -> int:
    """Let a process of its own install, and wait a while for it; the exit code."""
    say(f"installing; what happens is written to {LOG}")
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
        say("\n".join(LOG.read_text().splitlines()[-15:]))
    return code


def install(lock: int) -> int:
    """Make the environment and fill it; the exit code."""
    begin = time.monotonic()
    say(f"installing into {VENV} with Python {platform.python_version()}; this takes minutes, once")
    if not has_ready_wheels():
        say("ruckig and toppra have no ready wheels for this system and are compiled")
    from_here = ("--find-links", str(WHEELS)) if WHEELS.is_dir() else ()
    steps = (
        *(() if pip_works() else ((sys.executable, "-m", "venv", "--clear", str(VENV)),)),
        (
            *(str(PYTHON), "-m", "pip", "install", "--disable-pip-version-check", "--no-input"),
            *("--quiet", *NETWORK, *from_here),
            *("--constraint", "constraints.txt", "--editable", "."),
        ),
    )
    for step in steps:
        code = run(step, begin + LIMIT - time.monotonic(), lock)
        if code:
            say(f"error: the installation failed. {what_to_try()}")
            return 1
    DONE.write_text(asked_for())
    say(f"installed in {time.monotonic() - begin:.0f} s")
    return 0


def compile_wheels() -> int:
    """Compile what has no ready wheels, for this system and this Python; the exit code."""
    shutil.rmtree(WHEELS, ignore_errors=True)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run((sys.executable, "-m", "venv", folder), check=True)
        python = str(Path(folder) / "bin" / "python")
        command = (
            *(python, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-input"),
            *("--no-deps", "--no-binary", ",".join(COMPILED), "--wheel-dir", str(WHEELS)),
            *compiled_versions(),
        )
        return subprocess.run(command, cwd=HERE, check=False).returncode


def compiled_versions() -> list[str]:
    """Which versions are compiled: those of ``constraints.txt`` where there are no wheels."""
    pins = (HERE / "constraints.txt").read_text().splitlines()
    wanted = tuple(f"{name}==" for name in COMPILED)
    here = [pin for pin in pins if pin.startswith(wanted) and "platform_machine ==" not in pin]
    return [pin.partition(";")[0].strip() for pin in here]


def run(command: tuple[str, ...], limit: float, lock: int) -> int:
    """Run a command for at most ``limit`` seconds; the exit code.

    All it starts ends with it. It holds the lock too, in case this process is ended before it.
    """
    process = subprocess.Popen(
        command, cwd=HERE, stdin=subprocess.DEVNULL, start_new_session=True, pass_fds=(lock,)
    )
    try:
        return process.wait(max(limit, 0.0))
    except subprocess.TimeoutExpired:
        say(f"error: not done after {LIMIT / 60:.0f} minutes; it is ended")
        return 1
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def is_installed() -> bool:
    """Whether all that this version asks for is there."""
    return DONE.is_file() and DONE.read_text() == asked_for()


def asked_for() -> str:
    """What decides what is installed."""
    return "".join((HERE / name).read_text() for name in ("pyproject.toml", "constraints.txt"))


def pip_works() -> bool:
    """Whether there is an environment to go on with."""
    if not PYTHON.exists():
        return False
    asked = [str(PYTHON), "-m", "pip", "--version"]
    return subprocess.run(asked, capture_output=True, check=False).returncode == 0


def has_ready_wheels() -> bool:
    """Whether nothing has to be compiled here."""
    python = f"-cp{sys.version_info.major}{sys.version_info.minor}-"
    shipped = {path.name.split("-")[0] for path in WHEELS.glob(f"*{python}*.whl")}
    everywhere = (sys.platform, platform.machine()) == ("linux", "x86_64")
    return everywhere or shipped.issuperset(COMPILED)


def what_to_try() -> str:
    """A sentence or two for whoever reads why it failed."""
    has_compiler = any(shutil.which(name) for name in ("c++", "g++", "clang++"))
    has_headers = Path(sysconfig.get_path("include"), "Python.h").is_file()
    if has_ready_wheels() or (has_compiler and has_headers):
        return "Is the network there? It is tried again at the next start."
    missing = "Python's headers are" if has_compiler else "A C++ compiler is"
    if sys.platform == "darwin":
        return f"{missing} missing. try: xcode-select --install"
    return f"{missing} missing. try: apt-get install g++ cmake python3-dev"


@contextlib.contextmanager
def the_lock(patience: float) -> Iterator[int | None]:
    """Be the only installation while the block runs; None if another is, and does not end."""
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
    """To whoever watches, at once."""
    print(f"so101 setup: {sentence}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
