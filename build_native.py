"""Build the compiled part of planning; this is the build backend of the package.

``pip install`` calls it through the hooks at the end, which are setuptools' own with one step
before them. ``python build_native.py [--target TRIPLE]`` builds it in place, also for another
platform, such as ``aarch64-linux-gnu.2.17`` (needs ziglang).

The system's C compiler is used if one works. Otherwise the ``ziglang`` package is a build
requirement: a C compiler as a wheel, which pip installs for the build and removes after it. If
neither works the installation fails and says so: planning needs the library.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

HERE = Path(__file__).resolve().parent
SOURCES = HERE / "so101_motion" / "native"
ZIG = ("linux", "darwin", "win32")
ZIG_MACHINES = ("x86_64", "amd64", "aarch64", "arm64")
"""The platforms with wheels of ziglang."""

FLAGS = ("-std=c11", "-O3", "-fno-math-errno", "-w")
WIDTHS = (
    ("lanes.c", "-ffp-contract=fast", "-march=haswell"),
    ("furthest.c", "-ffp-contract=off", "-march=haswell"),
)
"""Sources that are compiled again for wider vectors on x86-64, with their flags."""
TIME_LIMIT = 300.0
"""Of one call of the compiler [s]."""


def system_compiler() -> list[str] | None:
    """The command of the system's C compiler, if it can make a library.

    None on Windows: GCC there does not align the stack for vectors of 32 bytes.
    """
    if sys.platform == "win32":
        return None
    for name in filter(None, (os.environ.get("CC"), "cc", "gcc", "clang")):
        if shutil.which(name.split()[0]):
            with tempfile.TemporaryDirectory() as folder:
                source = Path(folder, "tried.c")
                source.write_text("#include <math.h>\ndouble f(double x) { return sin(x); }\n")
                command = [*name.split(), "-shared", "-fPIC", "-o", f"{folder}/tried.so"]
                if _succeeds([*command, str(source), "-lm"], quiet=True):
                    return name.split()
    return None


def zig_compiler() -> list[str] | None:
    """The command of the ziglang package, if that is installed."""
    if importlib.util.find_spec("ziglang") is None:
        return None
    return [sys.executable, "-m", "ziglang", "cc"]


def build(target: str | None = None) -> Path:
    """Compile the library in place, unless it exists; return its file.

    Raises:
        SystemExit: No compiler works, or it fails; what it says is printed.
    """
    system, machine = sys.platform, platform.machine()
    if target:
        machine, system = target.split("-")[:2]
        if system == "macos":
            machine, system = machine.replace("aarch64", "arm64"), "darwin"
        elif system == "windows":
            machine, system = machine.replace("x86_64", "amd64"), "win32"
    file: Path = _library_module().library_file(system, machine)
    if file.is_file():
        return file
    compiler = zig_compiler() if target else system_compiler() or zig_compiler()
    if compiler is None:
        sys.exit("no C compiler works here; install one (gcc, clang) or: pip install ziglang")
    with tempfile.TemporaryDirectory() as folder:
        os.environ.setdefault("ZIG_GLOBAL_CACHE_DIR", f"{folder}/zig")
        os.environ.setdefault("ZIG_LOCAL_CACHE_DIR", f"{folder}/zig-here")
        if target:
            compiler += ["-target", target]
        if system != "win32":
            compiler.append("-fPIC")
        widths = WIDTHS if machine.lower() in ("x86_64", "amd64") else ()
        objects = []
        for k, (name, *flags) in enumerate(widths):
            objects.append(f"{folder}/wide{k}.o")
            source = str(SOURCES / name)
            if not _succeeds([*compiler, *FLAGS, *flags, "-c", source, "-o", objects[-1]]):
                sys.exit("the C library of planning could not be compiled; see above")
        sources = [str(each) for each in sorted(SOURCES.glob("*.c"))]
        made = f"{folder}/made.so"
        # Without contraction, arithmetic is the same on every processor.
        rest = ["-ffp-contract=off", "-shared"]
        if system == "darwin":  # which otherwise keeps the path it was linked at
            rest.append("-Wl,-install_name,@rpath/native.so")
        if "ziglang" in compiler:
            rest.append("-mcpu=baseline")  # otherwise it compiles for this processor
        if "ziglang" in compiler or system == "linux":
            rest.append("-s")
        if not _succeeds([*compiler, *FLAGS, *rest, "-o", made, *objects, *sources, "-lm"]):
            sys.exit("the C library of planning could not be compiled; see above")
        for old in SOURCES.glob(f"native-*-{system}-{machine.lower()}.so"):
            old.unlink()
        part = file.with_suffix(".part")
        shutil.copy(made, part)
        part.replace(file)
    return file


def _succeeds(command: Sequence[str], *, quiet: bool = False) -> bool:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT)
    except (OSError, subprocess.TimeoutExpired) as error:
        print(error, file=sys.stderr)
        return False
    if done.returncode and not quiet:
        print(done.stderr, file=sys.stderr)
    return done.returncode == 0


def _library_module() -> ModuleType:
    """Import ``library.py`` alone, because the package's requirements are not installed yet."""
    spec = importlib.util.spec_from_file_location("so101_native_library", SOURCES / "library.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _compiler_requirement() -> list[str]:
    """The build requirement: ziglang, unless there is a compiler or the library."""
    has_wheel = sys.platform in ZIG and platform.machine().lower() in ZIG_MACHINES
    if not has_wheel:
        return []
    is_there = _library_module().library_file().is_file() or system_compiler()
    return [] if is_there else ["ziglang>=0.14"]


def __getattr__(name: str) -> Any:
    """The hooks of PEP 517 and 660: setuptools' own, after ``build`` where they build."""
    hooks = ("build_wheel", "build_editable", "build_sdist")
    prepare = "prepare_metadata_for_build_"
    if name not in hooks and not name.startswith(("get_requires_for_build_", prepare)):
        raise AttributeError(name)
    from setuptools import build_meta

    hook = getattr(build_meta, name)

    def called(*args: Any, **kwargs: Any) -> Any:
        if name in ("build_wheel", "build_editable"):
            build()
        if name == "build_wheel" and len(list(SOURCES.glob("*.so"))) == 1:
            # It lacks the libraries of other systems (release.py makes them), so its name says so.
            folder, settings, metadata = (*args, None, None)[:3]
            option = [f"--plat-name={sysconfig.get_platform()}"]
            args = (folder, {**(settings or {}), "--build-option": option}, metadata)
        asked = hook(*args, **kwargs)
        if name in ("get_requires_for_build_wheel", "get_requires_for_build_editable"):
            asked = [*asked, *_compiler_requirement()]
        return asked

    return called


if __name__ == "__main__":
    print(build(sys.argv[2] if sys.argv[1:2] == ["--target"] else None))
