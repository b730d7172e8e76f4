"""The error when a needed package cannot be imported."""

import os
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from grpclib import GRPCError, Status
from harness.fake_parent import ARM, SIMULATED, running_module
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from so101_motion.common import import_check

ROOT = Path(__file__).parents[3]
LOST = "libgomp.so.1: cannot open shared object file: No such file or directory"


@pytest.fixture
def without_libgomp(tmp_path):
    """An environment in which pinocchio cannot be loaded, as on a minimal Debian."""
    (tmp_path / "pinocchio.py").write_text(f"raise ImportError({LOST!r})\n")
    (tmp_path / "apt-get").touch(mode=0o755)
    path = f"{tmp_path}:{os.environ['PATH']}"
    return {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}", "PATH": path}


def test_everything_needed_can_be_imported_here():
    assert import_check.main(["dev", "viewer"]) == 0


def test_what_is_needed_is_what_the_installation_brings():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    viewer = project["optional-dependencies"]["viewer"]
    wanted = [*map(Requirement, [*project["dependencies"], *viewer])]
    brought = set()
    while wanted:
        one = wanted.pop()
        is_wanted = one.marker is None or one.marker.evaluate({"extra": ""})
        if is_wanted and canonicalize_name(one.name) not in brought:
            brought.add(canonicalize_name(one.name))
            wanted += map(Requirement, metadata.requires(one.name) or ())
    packages = {"pinocchio": ["pin"], **metadata.packages_distributions()}
    for name in (*import_check.NEEDED, *import_check.NEEDED_BY_EXTRA["viewer"]):
        top = name.partition(".")[0]
        assert brought & {*map(canonicalize_name, packages.get(top, [top]))}, name


@pytest.mark.parametrize(
    "arguments",
    [("-m", "so101_motion.common.import_check"), ("-m", "so101_motion.cli", "demo", "--text")],
    ids=["the installation", "the command line"],
)
def test_a_missing_library_is_named_with_the_command_that_installs_it(without_libgomp, arguments):
    how = {"cwd": "/", "env": without_libgomp, "capture_output": True, "text": True}
    ended = subprocess.run([sys.executable, *arguments], **how, timeout=100, check=False)
    assert ended.returncode == 1
    assert "error: the system library libgomp.so.1 is missing" in ended.stderr
    assert "try: apt-get install libgomp1 (as root)" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert "defect" not in ended.stderr


async def test_viam_server_is_told_what_an_arm_lacks(without_libgomp, monkeypatch):
    for name in ("PYTHONPATH", "PATH"):
        monkeypatch.setenv(name, without_libgomp[name])
    async with running_module(command=(sys.executable, "-m", "so101_motion")) as (module, _, _):
        for call in (module.validate, module.add):
            with pytest.raises(GRPCError) as refused:
                await call(ARM, SIMULATED, {})
            assert refused.value.status is Status.FAILED_PRECONDITION
            assert "the system library libgomp.so.1 is missing. try: apt-get" in (
                refused.value.message
            )


def test_a_package_is_named_without_apt_or_when_unknown_and_a_defect_of_ours_not_explained(
    monkeypatch, tmp_path
):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert import_check.sentence(ImportError(LOST)).endswith("holds it (Debian: libgomp1)")
    error = ImportError("libodd.so.7: cannot open shared object file: No such file or directory")
    assert "libodd.so.7 is missing" in import_check.sentence(error)
    error = import_check.first_failure(["json", "no_such_package.part"])
    assert "no_such_package is not installed" in import_check.sentence(error)
    assert f"try: {ROOT / 'setup.sh'}" in import_check.sentence(error)
    assert import_check.explain(ImportError("cannot import name 'x' from 'y'")) is None
    assert import_check.explain(ModuleNotFoundError("no", name="so101_motion.gone")) is None


def test_everything_that_is_imported_is_tried():
    known = {name.partition(".")[0] for name in import_check.NEEDED} | set(sys.stdlib_module_names)
    optional = {"distributed", "mcap_ros2", "pyarrow", "scipy"}
    optional |= {"so101_motion", "so101_viewer", "so101_description"}
    found = set()
    for path in (ROOT / "so101_motion").rglob("*.py"):
        imports = r"^ *(?:from (\w+)\S* import |import (\w+)(?:\.\w+)*(?: as \w+)?(?: +#.*)?$)"
        for groups in re.findall(imports, path.read_text(), re.MULTILINE):
            found |= {*filter(None, groups)}
    assert found - known - optional == set()
