"""Compile what a Raspberry Pi would have to compile itself; ``build.sh linux/arm64`` calls this.

It makes the library of planning and two wheels of ruckig in ``wheels/``, one for Python 3.11 and
one for 3.12 and newer. Zig compiles for Linux on arm64 anywhere, and comes as a wheel. The headers
must be those of a Python that is installed here, of any processor.
"""

from __future__ import annotations

import base64
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

HERE = Path(__file__).resolve().parent
WHEELS = HERE / "wheels"
GLIBC = "2.28"
"""The oldest C library on which the result runs; packages that ours needs ask for the same."""
TARGET = f"aarch64-linux-gnu.{GLIBC}"
PLATFORM = f"manylinux_{GLIBC.replace('.', '_')}_aarch64"
TOOLS = ("nanobind==3.1.0", "ziglang==0.17.1")
KINDS = {
    # tag of the wheel: the Pythons that have headers for it, flags, name of the library
    "cp311-cp311": (("3.11",), (), "ruckig.cpython-311-aarch64-linux-gnu.so"),
    "cp312-abi3": (
        ("3.12", "3.13", "3.14"),
        ("-DPy_LIMITED_API=0x030C0000", "-include", "stdio.h"),
        "ruckig.abi3.so",
    ),
}
FLAGS = (
    *("-target", TARGET, "-mcpu=baseline", "-std=c++20", "-O3", "-DNDEBUG", "-w"),
    # Without contraction, arithmetic is the same on every processor.
    *("-ffp-contract=off", "-fPIC", "-fvisibility=hidden", "-fno-strict-aliasing"),
)


def main() -> None:
    """Compile everything."""
    shutil.rmtree(WHEELS, ignore_errors=True)
    WHEELS.mkdir()
    pins = (HERE / "constraints.txt").read_text().splitlines()
    pinned = next(pin for pin in pins if pin.startswith("ruckig=="))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python = str(folder / "bin" / "python")
        # First, because without them minutes of compiling would be lost.
        headers = {tag: headers_of(kind[0], folder / tag) for tag, kind in KINDS.items()}
        for cache in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"):
            os.environ.setdefault(cache, f"{name}/zig")
        run(sys.executable, "-m", "venv", name)
        run(python, "-m", "pip", "install", "--quiet", *TOOLS)
        source = ("--no-deps", "--no-binary", "ruckig", "--dest", name)
        run(python, "-m", "pip", "download", "--quiet", *source, pinned)
        run(python, "build_native.py", "--target", TARGET)
        (packed,) = folder.glob("ruckig-*.tar.gz")
        with tarfile.open(packed) as tar:
            tar.extractall(folder, filter="data")
        ruckig = folder / packed.name.removesuffix(".tar.gz")
        (nanobind,) = folder.glob("lib/python3*/site-packages/nanobind")
        include = (f"-I{ruckig}/include", f"-I{ruckig}/third_party", "-DWITH_CLOUD_CLIENT")
        compiled = partial(objects, (python, "-m", "ziglang", "c++", *FLAGS, *include), folder)
        common = compiled("", sorted(ruckig.glob("src/ruckig/*.cpp")))
        binding = [ruckig / "src/wrapper/python.cpp", nanobind / "src/nb_combined.cpp"]
        for tag, (_, flags, library) in KINDS.items():
            inside = (nanobind / "include", nanobind / "ext/robin_map/include", headers[tag])
            own = compiled(tag, binding, *flags, *(f"-I{path}" for path in inside))
            made = folder / library
            linked = ("-target", TARGET, "-O3", "-shared", "-s", "-o", str(made), *common, *own)
            run(python, "-m", "ziglang", "c++", *linked)
            pack(ruckig, made, tag)


def objects(
    compiler: tuple[str, ...], folder: Path, name: str, sources: list[Path], *flags: str
) -> list[str]:
    """Compile each source; return the object files."""
    made = [f"{folder}/{name}{source.stem}.o" for source in sources]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for _ in pool.map(
            lambda source, out: run(*compiler, *flags, "-c", str(source), "-o", out), sources, made
        ):
            pass
    return made


def headers_of(versions: tuple[str, ...], folder: Path) -> Path:
    """A copy of the headers of one of these Pythons, whatever processor it is for."""
    asked = "import sysconfig as s; print(s.get_path('include'), s.get_config_var('MULTIARCH'))"
    for version in versions:
        python = shutil.which(f"python{version}")
        words = (python or "false", "-c", asked)
        said = subprocess.run(words, capture_output=True, text=True).stdout.split()
        if said and (found := Path(said[0])).joinpath("Python.h").is_file():
            shutil.copytree(found, folder)
            # Debian's pyconfig.h includes that of the processor it is compiled for.
            of_processor = found.parent / said[1] / found.name / "pyconfig.h"
            if of_processor.is_file():
                shutil.copy(of_processor, folder)
            return folder
    sys.exit(
        f"error: the headers of Python {' or '.join(versions)} are needed, and none were found.\n"
        f"try: apt-get install python{versions[0]}-dev, or put such a Python on the PATH"
    )


def pack(source: Path, library: Path, tag: str) -> None:
    """Write the wheel of a compiled ruckig; the same input makes the same bytes."""
    about = f"{source.name}.dist-info"
    tags = f"{tag}-{PLATFORM}"
    files = {
        library.name: library.read_bytes(),
        f"{about}/METADATA": (source / "PKG-INFO").read_bytes(),
        f"{about}/licenses/LICENSE": (source / "LICENSE").read_bytes(),
        f"{about}/WHEEL": f"Wheel-Version: 1.0\nRoot-Is-Purelib: false\nTag: {tags}\n".encode(),
    }
    record = [f"{about}/RECORD,,\n"]
    for name, content in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        record.insert(-1, f"{name},sha256={digest},{len(content)}\n")
    files[f"{about}/RECORD"] = "".join(record).encode()
    with zipfile.ZipFile(WHEELS / f"{source.name}-{tags}.whl", "w") as wheel:
        for name, content in files.items():
            wheel.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)


def run(*command: str) -> None:
    """Run a command; end if it fails."""
    if subprocess.run(command, cwd=HERE).returncode:
        sys.exit(f"error: this failed: {' '.join(command)}")


if __name__ == "__main__":
    main()
