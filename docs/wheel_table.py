"""Write which packages have wheels for which systems into installation.md, as pip's index has them.

    python docs/wheel_table.py

It asks the index that pip is configured with once for each package that ``so101-motion[viewer]``
needs, in the version of ``constraints.txt``.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
import urllib.request
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.tags import Tag, compatible_tags, cpython_tags, mac_platforms
from packaging.utils import canonicalize_name, parse_wheel_filename

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "installation.md"
BEGIN, END = "<!-- wheels, by wheel_table.py -->\n", "<!-- end -->"

PYTHONS = ((3, 11), (3, 12), (3, 13), (3, 14))
SYSTEMS = {
    "Linux x86-64": ("linux", "Linux", "x86_64"),
    "Linux arm64": ("linux", "Linux", "aarch64"),
    "macOS arm64": ("darwin", "Darwin", "arm64"),
    "macOS x86-64": ("darwin", "Darwin", "x86_64"),
    "Windows x86-64": ("win32", "Windows", "AMD64"),
}
"""``sys.platform``, ``platform.system()`` and ``platform.machine()`` of each."""
GLIBC = range(36, 4, -1)  # Debian 12's and older
MACOS = (15, 0)


def tags(python: tuple[int, int], system: str) -> set[Tag]:
    """The tags of wheels that pip installs there."""
    sys_platform, _, machine = SYSTEMS[system]
    if sys_platform == "linux":
        old = [f"manylinux{name}_{machine}" for name in ("1", "2010", "2014")]
        platforms = [*(f"manylinux_2_{minor}_{machine}" for minor in GLIBC), *old]
    elif sys_platform == "darwin":
        platforms = list(mac_platforms(MACOS, machine))
    else:
        platforms = ["win_amd64"]
    interpreter = f"cp{python[0]}{python[1]}"
    return {
        *cpython_tags(python, platforms=platforms),
        *compatible_tags(python, interpreter, platforms),
    }


def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pairs = (line.split("==") for line in lines if "==" in line)
    return {canonicalize_name(name): version.strip() for name, version in pairs}


def needed(python: tuple[int, int], system: str) -> set[str]:
    """The packages that are installed there, dependencies of dependencies included."""
    sys_platform, name, machine = SYSTEMS[system]
    environment = {
        "python_version": "{}.{}".format(*python),
        "python_full_version": "{}.{}.0".format(*python),
        "sys_platform": sys_platform,
        "platform_system": name,
        "platform_machine": machine,
        "os_name": "nt" if sys_platform == "win32" else "posix",
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked_for = [*project["dependencies"], *project["optional-dependencies"]["viewer"]]
    waiting = [line.partition(";")[0] for line in asked_for]  # what planning needs, needs everybody
    found: dict[str, set[str]] = {}
    while waiting:
        asked = Requirement(waiting.pop())
        package, extras = canonicalize_name(asked.name), {"", *asked.extras}
        new = extras - found.setdefault(package, set())
        found[package] |= new
        waiting += [line for extra in new for line in _required(package, extra, environment)]
    return set(found)


def all_needed() -> set[str]:
    """The packages that are installed anywhere."""
    return set().union(*(needed(python, system) for python in PYTHONS for system in SYSTEMS))


def _required(package: str, extra: str, environment: Mapping[str, str]) -> Iterable[str]:
    try:
        lines = requires(package) or []
    except PackageNotFoundError:  # needed on another system only
        return
    for line in lines:
        asked = Requirement(line)
        if asked.marker is None:
            if not extra:
                yield line
        elif asked.marker.evaluate({**environment, "extra": extra}):
            yield line.partition(";")[0]


def wheels(package: str, version: str, index: str) -> set[Tag]:
    """The tags of all wheels of a version."""
    kind = "application/vnd.pypi.simple.v1+json"
    request = urllib.request.Request(f"{index.rstrip('/')}/{package}/", headers={"Accept": kind})
    with urllib.request.urlopen(request, timeout=60) as answer:
        files = json.load(answer)["files"]
    found: set[Tag] = set()
    for file in files:
        if file["filename"].endswith(".whl"):
            _, number, _, own = parse_wheel_filename(file["filename"])
            if str(number) == version:
                found |= own
    return found


def index_url() -> str:
    asked = (sys.executable, "-m", "pip", "config", "list")
    said = subprocess.run(asked, capture_output=True, text=True, check=True).stdout
    if own := re.search(r"\.index-url='(.+)'", said):
        return own[1]
    from pip._internal.models.index import PyPI

    return str(PyPI.simple_url)


def table() -> str:
    """The table, with a row for all packages that lack wheels for the same systems."""
    versions, index = pins(), index_url()
    wanted = {(python, system): needed(python, system) for python in PYTHONS for system in SYSTEMS}
    rows: dict[tuple[str, ...], list[str]] = {}
    for package in sorted(all_needed()):
        there, cells = wheels(package, versions[package], index), []
        for system in SYSTEMS:
            asked = [python for python in PYTHONS if package in wanted[python, system]]
            lacking = [python for python in asked if not there & tags(python, system)]
            names = ", ".join("{}.{}".format(*python) for python in lacking)
            none = "**none**" if lacking == asked else f"**none for {names}**"
            cells.append(none if lacking else "yes")
        rows.setdefault(tuple(cells), []).append(f"{package} {versions[package]}")
    full = ("yes",) * len(SYSTEMS)
    lines = [f"| package | {' | '.join(SYSTEMS)} |", f"|---|{'---|' * len(SYSTEMS)}"]
    for cells, names in sorted(rows.items(), key=lambda row: (row[0] == full, row[1])):
        which = f"the {len(names)} others" if cells == full else ", ".join(names)
        lines.append(f"| {which} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    before, _, rest = PAGE.read_text().partition(BEGIN)
    after = rest.partition(END)[2]
    PAGE.write_text(f"{before}{BEGIN}{table()}{END}{after}")


if __name__ == "__main__":
    main()
