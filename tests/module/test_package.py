"""The packages we publish: the archive for machines, the wheel and the source distribution.

Nothing here asks the network: the dependencies are those of the environment that runs the tests.
"""

import os
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pinocchio
import pytest
from harness.fake_parent import ARM, ROOT, SIMULATED, running_module
from viam.components.arm import Pose

SITE = sysconfig.get_path("purelib")
CMEEL = str(Path(pinocchio.__file__).parents[1])
HERE = f"{SITE}:{CMEEL}"
"""The dependencies, as PYTHONPATH: that leaves out the package itself, which is in development."""
TREE = f"{ROOT}:{HERE}"
"""The package as it lies here, and its dependencies."""
OFFLINE = {
    "PYTHONPATH": HERE,
    "PYTHON": sys.executable,
    "PIP_NO_INDEX": "1",
    "PIP_NO_DEPS": "1",
    "PIP_NO_BUILD_ISOLATION": "0",  # pip reads it that way round
}
HEAVY = ("scipy", "pinocchio", "coal", "toppra", "ruckig", "osqp", "viam", "viser", "rich")


def run(*command, cwd, **environment):
    """What a command prints; it must succeed."""
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def archive():
    run(ROOT / "build.sh", cwd="/")
    return ROOT / "dist" / "module.tar.gz"


def unpacked(archive, folder):
    with tarfile.open(archive) as tar:
        tar.extractall(folder, filter="tar")  # as viam-server does: the executable bits are kept
    return folder


@pytest.fixture(scope="module")
def distributions(archive, tmp_path_factory):
    """The source distribution, and the wheel that is built from it."""
    tree = unpacked(archive, tmp_path_factory.mktemp("tree"))
    out = tmp_path_factory.mktemp("dist")
    build = f"import setuptools.build_meta as b; b.build_sdist({str(out)!r})"
    run(sys.executable, "-c", build, cwd=tree)
    (sdist,) = out.glob("*.tar.gz")
    run(*(sys.executable, "-m", "pip", "wheel", sdist, "-w", out), cwd=out, **OFFLINE)
    (wheel,) = out.glob("*.whl")
    return sdist, wheel


def sources(folder):
    return {path.relative_to(folder) for path in folder.rglob("*.py")}


# The archive


def test_the_archive_holds_what_a_machine_needs_and_no_leftovers(archive):
    with tarfile.open(archive) as tar:
        names = {Path(name) for name in tar.getnames()}
    for part in ("so101_motion", "viewer", "urdf"):
        assert {Path(part) / name for name in sources(ROOT / part)} <= names
    assert {Path("meta.json"), Path("urdf/so101.urdf"), Path("docs/calibration.md")} <= names
    assert not [name for name in names if name.parts[0] == "tests"]
    assert not [name for name in names if any("cache" in part for part in name.parts)]
    assert archive.stat().st_size < 10e6


@pytest.mark.long  # an environment is installed
async def test_the_module_is_installed_and_runs_from_the_archive_in_an_empty_directory(
    archive, tmp_path, monkeypatch
):
    folder = unpacked(archive, tmp_path)
    for key, value in OFFLINE.items():
        monkeypatch.setenv(key, value)
    said = run(folder / "first_run.sh", cwd="/")
    assert "installed in" in said, said
    assert "installed already" in run(folder / "first_run.sh", cwd="/")

    monkeypatch.setenv("PIP_NO_DEPS", "0")  # whatever is asked for now could only fail
    async with running_module(command=(str(folder / "run.sh"),), cwd="/") as (module, models, _):
        assert os.readlink(f"/proc/{module.process.pid}/cwd") == str(folder)
        assert SIMULATED in models["arm"]
        arm = await module.add(ARM, SIMULATED, {"acceleration_degs_per_sec_per_sec": 500.0}, "arm")
        await arm.move_to_position(Pose(x=250, y=30, z=150, o_z=1))
        pose = await arm.get_end_position()
        assert (pose.x, pose.y, pose.z) == pytest.approx((250, 30, 150), abs=0.2)
        assert await arm.get_3d_models(), "the description is found too"


@pytest.mark.long  # an environment is installed
def test_a_first_run_that_cannot_install_does_not_hold_up_the_machine(archive, tmp_path):
    folder = unpacked(archive, tmp_path)
    cut_off = {**OFFLINE, "PIP_NO_DEPS": "0", "PYTHONPATH": ""}
    said = run(folder / "first_run.sh", cwd="/", **cut_off)
    assert "error: the installation failed. pip's messages above have the reason." in said

    failed = subprocess.run(
        [folder / "run.sh", "m.sock"], env={**os.environ, **cut_off}, capture_output=True, text=True
    )
    assert failed.returncode != 0
    assert "the installation failed" in failed.stderr, "what setup.log says is told"


# The Python package


@pytest.mark.long  # a library is compiled
def test_wheel_and_source_distribution_hold_the_description_and_the_types(distributions):
    sdist, wheel = distributions
    with tarfile.open(sdist) as tar:
        in_sdist = {str(Path(*Path(name).parts[1:])) for name in tar.getnames()}
    with zipfile.ZipFile(wheel) as zipped:
        in_wheel = set(zipped.namelist())
    meshes = {path.name for path in (ROOT / "urdf" / "meshes").iterdir()}
    for data in ("so101.urdf", "py.typed", *(f"meshes/{name}" for name in meshes)):
        assert f"urdf/{data}" in in_sdist
        assert f"so101_description/{data}" in in_wheel
    for name, folder in (("so101_motion", "so101_motion"), ("so101_viewer", "viewer")):
        assert f"{name}/py.typed" in in_wheel
        assert {f"{name}/{source}" for source in sources(ROOT / folder)} <= in_wheel


def test_importing_the_package_loads_next_to_nothing(tmp_path):
    code = (
        "import sys; before = set(sys.modules); import so101_motion\n"
        "print(*(name for name in set(sys.modules) - before\n"
        "    if name.partition('.')[0] not in sys.stdlib_module_names))\n"
        f"import so101_motion.cli.verbs; print([name for name in {HEAVY} if name in sys.modules])"
    )
    said = run(sys.executable, "-c", code, cwd=tmp_path, PYTHONPATH=TREE).split("\n")
    assert said[:2] == ["so101_motion", "[]"]


def test_without_the_viewer_the_preview_says_what_to_install(tmp_path):
    code = (
        "import sys; sys.modules['viser'] = None\n"
        "from so101_motion.cli.verbs import main; main(['demo'], standalone_mode=False)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": TREE},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode != 0
    assert "needs viser, which is not installed" in done.stderr
    pinned = next(
        line
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if line.startswith("viser==")
    )
    command = f"{sys.executable} -m pip install {pinned} "
    assert f"install it: {command}" in done.stderr  # works anywhere
