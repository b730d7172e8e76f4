#!/usr/bin/env python3
"""Make minimal Debian machines, type the README's commands on them, and record what happened.

Needs root on a Debian with ``mmdebstrap`` and the network; not part of ``make test``. From the
top of the checkout, everything that is committed is tried:

    python3 tests/machines/try_machines.py
    python3 tests/machines/try_machines.py --release trixie --user root --part readme

Each trial has a machine of its own, a folder made from the package sources of this machine and
entered with ``chroot``; its mounts and processes are in namespaces that end with the command.
``readme`` types what the README says: the installation, the demo, the demo as text, ``make test``
(a few tests, one of them in the browser), then ``setup.sh`` and ``run.sh``. ``stumble`` begins
with less than the README asks for, and types whatever command the error messages name.

What came of each line goes to ``benchmarks/results/machines.json``, to the table of
``benchmarks/README.md`` and to the terminal.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RESULT = ROOT / "benchmarks" / "results" / "machines.json"
PAGE = ROOT / "benchmarks" / "README.md"
BEGIN, END = "<!-- machines, by try_machines.py -->\n", "<!-- end -->\n"
RELEASES = {"bookworm": "Debian 12", "trixie": "Debian 13"}
USERS = ("root", "newcomer")
SELECTION = (
    "tests/unit/test_install.py tests/unit/common/test_import_check.py "
    "tests/module/test_process.py::test_a_session_from_the_handshake_to_the_end "
    "tests/browser/test_windows_and_devices.py::test_p_plans_escape_and_space_stop_also_in_a_field_and_no_other_key_moves_the_arm"
)
"""The tests of the trial; all of them take too long to be tried on eight machines."""
ENOUGH = 3000.0
"""No command takes as long, also where others compute [s]."""
PIP_CONFIGURATION = Path("/etc/pip.conf")
AUTHORITIES = Path("/usr/local/share/ca-certificates")
"""Certificates that a network of its own may need; installed along with ca-certificates."""
CA_BUNDLE = Path("/etc/ssl/certs/ca-certificates.crt")
"""What pip reads until that package is there."""


class StoppedError(Exception):
    """A step went wrong, so the rest of the trial would show nothing."""


@dataclass
class Row:
    """One thing that was typed, and what came of it."""

    machine: str
    trial: str
    user: str
    typed: str
    result: str
    ok: bool
    seconds: float


@dataclass
class Machine:
    """A minimal Debian in a folder.

    Attributes:
        root: The folder.
        name: Such as "Debian 12".
        user: Who types what does not need root.
        trial: What is tried.
        rows: What was tried so far.
        shared: A folder of this machine that it sees under the same name.
        patience: No command takes as long [s].
    """

    root: Path
    name: str
    user: str
    trial: str
    rows: list[Row] = field(default_factory=list)
    shared: Path | None = None
    patience: float = ENOUGH

    @property
    def home(self) -> str:
        return "/root" if self.user == "root" else f"/home/{self.user}"

    def command(self, line: str, folder: str, user: str) -> list[str]:
        """What runs a line of shell on this machine, in namespaces that end with it.

        Words that are added to it are the line's ``$@``.
        """
        home = "/root" if user == "root" else f"/home/{user}"
        path = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
        inside = f"cd {shlex.quote(folder)} && {line}"
        words = (
            *("chroot", f"--userspec={user}", str(self.root)),
            *("env", "-i", f"HOME={home}", f"PATH={path}", "LANG=C.UTF-8"),
            *(f"{name}={value}" for name, value in passed_on().items()),
            *("sh", "-c", inside, "sh"),
        )
        mounts = f"mount -t proc proc {self.root}/proc && mount --rbind /dev {self.root}/dev"
        if self.shared:
            mounts += f" && mount --bind {self.shared} {self.root}{self.shared}"
        script = f'{mounts} && exec {shlex.join(words)} "$@"'
        return ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", script, "sh"]

    def type(self, line: str, *, folder: str = "", as_root: bool = False) -> tuple[int, str, float]:
        user = "root" if as_root else self.user
        begin = time.monotonic()
        done = subprocess.run(
            self.command(line, folder or self.home, user),
            input="y\n" * 20,  # apt-get asks
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=self.patience,
        )
        said = (f"    | {each}" for each in done.stdout.strip().splitlines()[-25:])
        say("\n".join((f"{self.name}, {user}: {line}", *said)))
        return done.returncode, done.stdout, time.monotonic() - begin

    def expect(
        self,
        line: str,
        judge: Callable[[int, str], str],
        *,
        folder: str = "",
        as_root: bool = False,
        shown: str = "",
    ) -> str:
        """Type a line and write down what ``judge`` thinks of it; empty means it went wrong."""
        code, said, seconds = self.type(line, folder=folder, as_root=as_root)
        self.note(shown or line, judge(code, said), last_words(said), seconds, as_root=as_root)
        return said

    def note(
        self, typed: str, verdict: str, otherwise: str, seconds: float, *, as_root: bool = False
    ) -> None:
        user = "root" if as_root else "ordinary" if self.user != "root" else "root"
        result = verdict or f"FAILED: {otherwise}"
        self.rows.append(
            Row(self.name, self.trial, user, typed, result, bool(verdict), round(seconds, 1))
        )
        say(f"{self.name}, {user}: {typed}: {result}, {seconds:.0f} s")
        if not verdict:
            raise StoppedError


def passed_on() -> dict[str, str]:
    """What pip on this machine is told by its environment, but for folders of this machine."""
    return {
        name: value
        for name, value in os.environ.items()
        if (name.startswith("PIP_") and name != "PIP_FIND_LINKS")
        or name.lower() in ("http_proxy", "https_proxy", "no_proxy")
    }


def archive() -> str:
    form = "$(REPO_URI) $(ORIGIN) $(LABEL)"
    asked = ["apt-get", "indextargets", "--format", form, "Created-By: Packages"]
    said = subprocess.run(asked, capture_output=True, text=True, check=True).stdout
    found = [line.split()[0] for line in said.splitlines() if line.endswith("Debian Debian")]
    if not found:
        sys.exit("no package source of Debian is configured here; run apt-get update first")
    return found[0]


def make(base: Path, release: str) -> None:
    source = f"deb {archive()} {release} main"
    command = ["mmdebstrap", "--mode=root", "--variant=minbase", release, str(base), source]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    for file in (PIP_CONFIGURATION, CA_BUNDLE, *AUTHORITIES.glob("*.crt")):
        if file.exists():
            there = base / file.relative_to("/")
            there.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file, there)
    in_it = ["chroot", str(base), "sh", "-c"]
    user = "useradd --create-home --shell /bin/sh newcomer"
    subprocess.run([*in_it, f"{user} && apt-get update -qq"], check=True)


def clone(machine: Machine, name: str) -> str:
    folder = f"{machine.home}/{name}"
    there = machine.root / folder.lstrip("/")
    quiet = ["git", "clone", "--quiet", "--no-hardlinks", str(ROOT), str(there)]
    subprocess.run(quiet, check=True)
    if machine.user != "root":
        owner = f"{machine.user}:{machine.user}"
        in_it = ["chroot", str(machine.root), "chown", "-R", owner, folder]
        subprocess.run(in_it, check=True)
    return folder


def shown_lines(having: str) -> list[tuple[bool, str]]:
    """The lines of the README's block with this command: whether it is root's, and the line."""
    blocks = re.findall(r"```console\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    block = next(block for block in blocks if f"$ {having}" in block)
    lines = [line.partition("  #")[0].strip() for line in block.splitlines()]
    return [(line.startswith("# "), line[2:]) for line in lines if line[:2] in ("# ", "$ ")]


def try_readme(machine: Machine) -> None:
    folder = clone(machine, "so101_motion")
    for is_root, line in shown_lines("make demo"):
        if is_root:
            machine.expect(line, done, as_root=True)
        else:
            try_demo(machine, line, folder)
    machine.expect(".venv/bin/so101 demo --text", arrives, folder=folder)
    size = megabytes(machine.root / folder.lstrip("/") / ".venv")
    machine.note("(disk: .venv after make demo)", f"{size} MB", "", 0.0)
    for is_root, line in shown_lines("make test"):
        if is_root and machine.user != "root":  # root's make test installs these itself
            machine.expect(line, done, as_root=True)
        if line == "make test":
            few = f"PYTEST_ADDOPTS={shlex.quote(SELECTION)} {line}"
            machine.expect(few, passed, folder=folder, shown="make test (a few tests)")
    size = megabytes(machine.root / folder.lstrip("/") / ".venv")
    machine.note("(disk: .venv after make test)", f"{size} MB", "", 0.0)
    second = clone(machine, "second")
    machine.expect("./setup.sh", done, folder=second)
    size = megabytes(machine.root / second.lstrip("/") / ".venv")
    machine.note("(disk: .venv of the module)", f"{size} MB", "", 0.0)
    try_run(machine, second)
    size = megabytes(machine.root)
    machine.note("(disk: the whole machine, two clones)", f"{size} MB", "", 0.0)


def try_stumbling(machine: Machine) -> None:
    """Begin without venv and libgomp1, and type what the messages say."""
    folder = clone(machine, "so101_motion")
    machine.expect("apt-get install git make python3", done, as_root=True)
    for _ in range(3):
        said = machine.expect("make demo", names_a_command, folder=folder)
        named = re.search(r"try: (apt-get install [^(\n]*)", said)
        if named is None:
            break
        if "libgomp" in named[1]:
            machine.expect("./run.sh /tmp/so101.sock", names_a_command, folder=folder)
        machine.expect(named[1].strip(), done, as_root=True)
        if "libgomp" in named[1]:
            try_demo(machine, "make demo", folder)
            try_run(machine, folder)
            break
    if machine.user != "root":
        few = f"PYTEST_ADDOPTS={shlex.quote(SELECTION)} make test"
        said = machine.expect(few, names_a_command, folder=folder, shown="make test (a few tests)")
        named = re.search(r"try: (apt-get install [^(\n]*)", said)
        if named:
            machine.expect(named[1].strip(), done, as_root=True)
        machine.expect(few, passed, folder=folder, shown="make test (a few tests)")


def try_demo(machine: Machine, line: str, folder: str) -> None:
    log = machine.root / "tmp" / "demo.log"
    begin = time.monotonic()
    with log.open("w") as out:
        command = machine.command(line, folder, machine.user)
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=out, start_new_session=True
        )
    link = None
    while link is None and process.poll() is None and time.monotonic() - begin < ENOUGH:
        time.sleep(0.1)
        link = re.search(r"^open\s+(http\S+)", log.read_text(), re.MULTILINE)
    seconds = time.monotonic() - begin
    verdict = ""
    if link:
        size = len(asked_as_browser(link[1]))
        verdict = f"a link; the page comes ({size // 1000} kB)" if size > 100_000 else ""
        os.killpg(process.pid, signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(120.0)
        verdict = verdict if "ended by Ctrl-C" in log.read_text() else ""
    end(process)
    machine.note(line, verdict, last_words(log.read_text()), seconds)


def asked_as_browser(link: str) -> bytes:
    cookies = urllib.request.HTTPCookieProcessor()
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), cookies)
    with opener.open(link, timeout=30.0):
        pass
    page: bytes
    with opener.open(link.partition("?")[0], timeout=30.0) as answer:
        page = answer.read()
    return page


def try_run(machine: Machine, folder: str) -> None:
    socket = machine.root / "tmp" / "so101.sock"
    socket.unlink(missing_ok=True)
    log = machine.root / "tmp" / "run.log"
    begin = time.monotonic()
    with log.open("w") as out:
        line = "exec ./run.sh /tmp/so101.sock"
        process = subprocess.Popen(
            machine.command(line, folder, machine.user), stdout=out, stderr=out
        )
    while not socket.exists() and process.poll() is None and time.monotonic() - begin < 60.0:
        time.sleep(0.05)
    verdict = "listens on its socket" if socket.exists() else ""
    seconds = time.monotonic() - begin
    end(process)
    machine.note("./run.sh SOCKET", verdict, last_words(log.read_text()), seconds)


def end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


def done(code: int, _said: str) -> str:
    return "" if code else "done"


def arrives(code: int, said: str) -> str:
    return "" if code or "arrived at" not in said else "plans, moves, arrives"


def passed(code: int, said: str) -> str:
    found = re.search(r"(\d+ passed[^\n=]*)", said)
    return "" if code or found is None else found[1].strip()


def names_a_command(code: int, said: str) -> str:
    found = re.search(r"(error: [^\n]*)\n?(.*?(try: apt-get install [^\n]*))?", said, re.DOTALL)
    fine = code and found and "try: apt-get install" in said and "Traceback" not in said
    advice = re.search(r"try: apt-get install [^(\n]*", said)
    return f"says {advice[0].strip()!r}" if fine and advice else ""


def last_words(said: str) -> str:
    return " / ".join(said.strip().splitlines()[-3:])[-300:]


def megabytes(folder: Path) -> int:
    command = ["du", "--summarize", "--one-file-system", "--block-size=1000000", str(folder)]
    return int(
        subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[0]
    )


def say(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


def committed() -> str:
    asked = ["git", "rev-parse", "--short", "HEAD"]
    return subprocess.run(
        asked, cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


def write(result: Path, rows: list[Row], commit: str) -> None:
    before = json.loads(result.read_text())["rows"] if result.exists() else []
    these = {(row.machine, row.trial) for row in rows}
    kept = [row for row in before if (row["machine"], row["trial"]) not in these]
    new = [{**asdict(row), "commit": commit} for row in rows]
    everything = sorted(kept + new, key=lambda row: (row["machine"], row["trial"]))
    result.write_text(json.dumps({"benchmark": "machines", "rows": everything}, indent=1) + "\n")
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}{table(everything)}{END}{rest.partition(END)[2]}")


def table(rows: list[dict[str, Any]]) -> str:
    """A row for each line that was typed, with what came of it on both releases of Debian."""
    trials: dict[tuple[str, str], dict[str, list[dict[str, Any]]]] = {}
    for row in rows:
        release, _, emulated = row["machine"].partition(", ")
        found = trials.setdefault((emulated, row["trial"]), {})
        found.setdefault(release, []).append(row)
    names = tuple(RELEASES.values())
    lines = [f"| typed | {' | '.join(names)} |", "|---|---|---|"]
    for (emulated, trial), found in sorted(trials.items()):
        commits = [
            ", ".join(sorted({row["commit"] for row in found.get(name, [])})) for name in names
        ]
        title = ", ".join(filter(None, (emulated, trial)))
        lines.append(f"| **{title}**, at commit | {' | '.join(commits)} |")
        for step in zip_longest(*(found.get(name, []) for name in names)):
            typed = " / ".join(dict.fromkeys(f"`{row['typed']}`" for row in step if row))
            lines.append(f"| {typed} | {' | '.join(map(cell, step))} |")
    return "\n".join(lines) + "\n"


def cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return ""
    return row["result"] + (f", {row['seconds']:.0f} s" if row["seconds"] else "")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--release", action="append", choices=RELEASES, help="default: both")
    parser.add_argument("--user", action="append", choices=USERS, help="default: both")
    parser.add_argument("--part", action="append", choices=("readme", "stumble"))
    parser.add_argument("--work", type=Path, default=Path("/tmp/so101-machines"))
    parser.add_argument("--result", type=Path, default=RESULT)
    given = parser.parse_args()
    if os.geteuid() != 0 or not shutil.which("mmdebstrap"):
        sys.exit("this needs root and mmdebstrap (apt-get install mmdebstrap)")
    # A shell that starts this in the background has it ignore Ctrl-C, and what it starts as well.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    parts = {"readme": try_readme, "stumble": try_stumbling}
    rows: list[Row] = []
    given.work.mkdir(parents=True, exist_ok=True)
    for release in given.release or RELEASES:
        base = given.work / release
        if not base.exists():
            make(base, release)
        for part in given.part or parts:
            for user in given.user or USERS:
                root = given.work / f"{release}-{part}-{user}"
                shutil.rmtree(root, ignore_errors=True)
                subprocess.run(["cp", "-a", str(base), str(root)], check=True)
                trial = f"{part}, {'root' if user == 'root' else 'ordinary user'}"
                machine = Machine(root, RELEASES[release], user, trial)
                commit = committed()
                with contextlib.suppress(StoppedError):
                    parts[part](machine)
                rows += machine.rows
                write(given.result, machine.rows, commit)
                shutil.rmtree(root)
    return 0 if all(row.ok for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
