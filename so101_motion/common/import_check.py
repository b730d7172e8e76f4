"""Import every package that is needed, and explain which one is missing.

The installation ends with ``python -m so101_motion.common.import_check``. ``run.sh`` and the
command line give the same explanation when a library goes missing later. Python wheels bring most
of the libraries they need; a minimal system lacks a few of the others.
"""

from __future__ import annotations

import importlib
import os
import re
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path

NEEDED = (
    *("click", "coal", "google.protobuf", "grpclib", "h2", "mapbox_earcut", "msgspec"),
    *("numpy", "osqp", "pinocchio", "plyfile", "rich", "ruckig", "serial", "trimesh"),
    "viam.module.module",
)
"""Packages that the module, the library and the command line import."""

NEEDED_BY_EXTRA = {
    "viewer": ("viser", "websockets"),
    "dev": (
        *("hypothesis", "manifold3d", "mcap_ros2", "playwright", "pyarrow", "pytest"),
        *("qpsolvers", "scservo_sdk"),
    ),
}
"""Further packages of each extra of the installation."""

DEBIAN_PACKAGES = {
    "libatomic.so.1": "libatomic1",
    "libgcc_s.so.1": "libgcc-s1",
    "libgomp.so.1": "libgomp1",
    "libstdc++.so.6": "libstdc++6",
    "libz.so.1": "zlib1g",
}
"""Which package of Debian and Ubuntu holds a system library."""

_LIBRARY = re.compile(r"(\S+?\.so[.\d]*): cannot open shared object file")
_ROOT = Path(__file__).resolve().parents[2]


def explain(error: ImportError) -> tuple[str, str] | None:
    """What is missing, and what to do about it; None if an import failed for another cause."""
    found = _LIBRARY.search(str(error))
    if found:
        return f"the system library {found[1]} is missing", _how_to_get(found[1])
    package = (error.name or "").partition(".")[0]
    if sys.platform == "win32" and package in ("coal", "pinocchio"):
        return "Pinocchio, which plans, has no package for Windows", "WSL2; README.md says how"
    if not isinstance(error, ModuleNotFoundError) or package.startswith("so101_"):
        return None
    version = ".".join(map(str, sys.version_info[:2]))
    what = f"the Python package {package} is not installed for Python {version} in {sys.prefix}"
    setup = _ROOT / "setup.sh"
    return what, str(setup) if setup.exists() else f"{sys.executable} -m pip install {package}"


def sentence(error: ImportError) -> str:
    """Return the explanation in one line; the error's own text if there is none."""
    explained = explain(error)
    return str(error) if explained is None else "{}. try: {}".format(*explained)


def first_failure(names: Iterable[str]) -> ImportError | None:
    """Import the packages one after the other; return the first error, or None."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads would only cost memory here
    for name in names:
        try:
            importlib.import_module(name)
        except ImportError as error:
            return error
    return None


def main(extras: list[str]) -> int:
    added = [name for extra in extras for name in NEEDED_BY_EXTRA.get(extra, ())]
    error = first_failure((*NEEDED, *added))
    if error is None:
        return 0
    print(f"error: {sentence(error)}", file=sys.stderr)
    return 1


def _how_to_get(library: str) -> str:
    package = DEBIAN_PACKAGES.get(library)
    if package is None:
        return f"install the package of your system that holds {library}"
    if shutil.which("apt-get"):
        return f"apt-get install {package} (as root)"
    return f"install the package of your system that holds it (Debian: {package})"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
