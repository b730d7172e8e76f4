"""The installer, which must never hold a machine up."""

import importlib.util
import os
import shutil
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def installer(tmp_path):
    """The script, in a directory of its own with what it reads there."""
    for name in ("install.py", "setup.sh", "first_run.sh", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    spec = importlib.util.spec_from_file_location("so101_installer", tmp_path / "install.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def processes():
    return {int(path.name) for path in Path("/proc").glob("[0-9]*")}


def command_of(pid):
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""


def test_what_is_complete_is_left_alone(installer, capsys):
    installer.VENV.mkdir()
    assert not installer.is_installed()
    installer.DONE.write_text(installer.asked_for())

    assert installer.main([]) == 0
    assert installer.main(["--background"]) == 0
    assert capsys.readouterr().err.count("installed already") == 2


def test_a_new_version_is_noticed(installer):
    installer.VENV.mkdir()
    installer.DONE.write_text(installer.asked_for())
    assert installer.is_installed()
    with (installer.HERE / "constraints.txt").open("a") as file:
        file.write("another==1.0\n")
    assert not installer.is_installed()


def test_what_is_compiled_is_what_has_sources(installer):
    """toppra's newest is there as a wheel for x86-64 Linux alone, and cannot be compiled."""
    assert installer.compiled_versions() == ["ruckig==0.19.4", "toppra==0.6.3"]


def test_two_installations_do_not_run_at_once(installer, capsys):
    with installer.the_lock(0.0) as first:
        assert first is not None
        with installer.the_lock(0.0) as second:
            assert second is None
        installer.PATIENCE = 0.0
        assert installer.in_foreground() == 1
    assert "another installation is still running" in capsys.readouterr().err
    with installer.the_lock(0.0) as third:
        assert third is not None


def test_a_step_that_hangs_is_ended_with_all_it_started(installer, capsys):
    mark = f"30.0{os.getpid()}"
    begin = time.monotonic()
    with installer.the_lock(0.0) as lock:
        assert installer.run(("sh", "-c", f"sleep {mark} & wait"), 0.2, lock) == 1
    assert time.monotonic() - begin < 5.0
    assert "it is ended" in capsys.readouterr().err
    deadline = time.monotonic() + 5.0
    while any(mark in command_of(pid) for pid in processes()):  # the kernel takes a moment
        assert time.monotonic() < deadline


def test_compiled_wheels_that_came_along_are_counted_for_this_python_alone(installer, monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    assert not installer.has_ready_wheels()
    installer.WHEELS.mkdir()
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}"
    for name in (f"ruckig-0.19.4-{tag}-{tag}-any.whl", "toppra-0.6.3-cp39-cp39-any.whl"):
        (installer.WHEELS / name).touch()
    assert not installer.has_ready_wheels()
    (installer.WHEELS / f"toppra-0.6.3-{tag}-{tag}-any.whl").touch()
    assert installer.has_ready_wheels()


@pytest.mark.parametrize(
    ("platform", "says"),
    [("linux", "apt-get install g++ cmake python3-dev"), ("darwin", "xcode-select --install")],
)
def test_a_missing_compiler_is_named(installer, monkeypatch, platform, says):
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr("platform.machine", lambda: "arm64")
    monkeypatch.setenv("PATH", str(installer.HERE))
    assert says in installer.what_to_try()


def test_without_python_the_first_run_says_so_and_succeeds(installer, tmp_path):
    tools = tmp_path / "bin"
    tools.mkdir()
    for name in ("sh", "dirname"):
        (tools / name).symlink_to(shutil.which(name))
    said = tmp_path / "said"
    status = os.waitstatus_to_exitcode(
        os.system(f"env -i PATH={tools} {tools}/sh {tmp_path}/first_run.sh 2>{said}")
    )
    assert status == 0
    assert "no Python 3.11 or newer with venv was found" in said.read_text()


def test_an_unknown_argument_is_refused(installer, capsys):
    assert installer.main(["--quick"]) == 2
    assert "usage" in capsys.readouterr().err
