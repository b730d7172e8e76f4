"""Make what a release consists of in ``dist/``: ``make release``.

The wheel, which carries the library of planning for every system with wheels of Pinocchio; the
plugin's wheel, and ruckig's for Linux on arm64; the source distribution; the module's archives; a
bill of materials (CycloneDX) of what the wheel needs; ``SHA256SUMS``. All are made from the last
commit in an environment of their own with pinned tools, and nothing in them depends on the time or
the folder: two builds have the same bytes.
"""

from __future__ import annotations

import gzip
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
DIST = HERE / "dist"
TOOLS = ("cyclonedx-bom==7.5.0", "setuptools==84.2.1", "ziglang==0.17.1")
TARGETS = ("x86_64-linux-gnu.2.28", "aarch64-linux-gnu.2.28", "aarch64-macos", "x86_64-macos")
"""What ``build_native.py`` is asked for. Windows has no Pinocchio, without which nothing plans."""
ARCHIVES = ("", "linux/arm64")
"""What ``build.sh`` is asked for."""


def main() -> None:
    """Build everything anew."""
    commit, epoch = run("git", "log", "-1", "--format=%h %ct").split()
    if run("git", "status", "--porcelain"):
        print(f"so101 release: changes after {commit} are left out", file=sys.stderr)
    shutil.rmtree(DIST, ignore_errors=True)
    DIST.mkdir()
    with tempfile.TemporaryDirectory() as name:
        tree, tools = Path(name, "tree"), Path(name, "tools")
        os.environ["SOURCE_DATE_EPOCH"] = epoch
        run(sys.executable, "-m", "venv", str(tools))
        python = str(tools / "bin" / "python")
        run(python, "-m", "pip", "install", "--quiet", *TOOLS)
        run("git", "archive", "--format=tar", f"--output={name}/tree.tar", "HEAD")
        with tarfile.open(f"{name}/tree.tar") as tar:
            tar.extractall(tree, filter="data")

        backend = f"import build_native as b; b.build_sdist({str(DIST)!r})"
        run(python, "-c", backend, cwd=tree)
        for archive in ARCHIVES:
            run("./build.sh", *archive.split(), cwd=tree)
        for made in (*(tree / "dist").glob("*.tar.gz"), *(tree / "wheels").glob("*.whl")):
            shutil.copy(made, DIST)
        for packed in DIST.glob("*.tar.gz"):
            pack_again(packed, int(epoch))
        for target in TARGETS:
            run(python, "build_native.py", "--target", target, cwd=tree)
        run(python, "-c", backend.replace("sdist", "wheel"), cwd=tree)
        plugin = backend.replace("build_native", "setuptools.build_meta").replace("sdist", "wheel")
        run(python, "-c", plugin, cwd=tree / "lerobot_robot_so101_motion")
        bill_of_materials(tools / "bin" / "cyclonedx-py", tree)
    sums = [
        f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n"
        for file in sorted(DIST.iterdir())
    ]
    (DIST / "SHA256SUMS").write_text("".join(sums))
    print("".join(sums), end="")


def pack_again(archive: Path, epoch: int) -> None:
    """Write a tar.gz again: sorted, of nobody, all of one time."""
    part = archive.with_suffix(".part")
    with (
        tarfile.open(archive) as old,
        part.open("wb") as file,
        gzip.GzipFile("", "wb", 9, file, mtime=epoch) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as new,
    ):
        for member in sorted(old.getmembers(), key=lambda each: each.name):
            content = old.extractfile(member) if member.isfile() else None
            member.mtime, member.pax_headers = epoch, {}
            member.uid = member.gid = 0
            member.uname = member.gname = ""
            member.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            new.addfile(member, content)
    part.replace(archive)


def bill_of_materials(tool: Path, tree: Path) -> None:
    """List what the wheel needs with its page, on any system and for any Python."""
    asked = "import wheel_table as t; print(*t.all_needed())"
    needed = set(run(sys.executable, "-c", asked, cwd=tree / "docs").split())
    lines = (tree / "constraints.txt").read_text().splitlines()
    own = [line for line in lines if line.partition("==")[0].lower().replace("_", "-") in needed]
    (tree / "runtime.txt").write_text("\n".join(own) + "\n")
    made = f"--output-file={DIST}/sbom.cdx.json"
    about = ("--pyproject", "pyproject.toml", "--output-reproducible", made)
    run(str(tool), "requirements", *about, "runtime.txt", cwd=tree)


def run(*command: str, cwd: Path = HERE) -> str:
    """What a command prints on stdout; end if it fails, with what it printed on stderr."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{done.stderr}error: this failed: {' '.join(command)}")
    return done.stdout.strip()


if __name__ == "__main__":
    main()
