"""The installer never holds a machine up."""

import importlib.util
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PINS = ("pyproject.toml", "constraints.txt")


@pytest.fixture
def installer(tmp_path):
    """The script, in a directory of its own with what it reads there."""
    for name in ("install.py", "setup.sh", "run.sh", "first_run.sh", *PINS):
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


HERE = ".".join(map(str, sys.version_info[:2]))


def pretend_environment(installer, *, version=HERE, imports=0, extras=()):
    """An environment in which pip says its version and has done its work."""
    installer.PYTHON.parent.mkdir(parents=True, exist_ok=True)
    installer.PYTHON.write_text(
        "#!/bin/sh\n"
        f'[ "$3" = --version ] && echo "pip 25.0 from /here (python {version})" && exit\n'
        'echo "$*" >>"$(dirname "$0")/asked"\n'
        f'case "$*" in *import_check*) echo "error: libodd is missing" >&2; exit {imports};; esac\n'
    )
    installer.PYTHON.chmod(0o755)
    installer.PACKAGES.write_text(installer.record(set(extras)))


def asked_of(installer):
    asked = installer.PYTHON.parent / "asked"
    return asked.read_text().splitlines() if asked.exists() else []


def test_a_complete_installation_is_left_alone_until_there_is_a_new_version(installer, capsys):
    pretend_environment(installer)
    assert not installer.is_installed(set())
    assert installer.main([]) == 0
    assert installer.is_installed(set())
    capsys.readouterr()

    assert installer.main([]) == 0
    assert installer.main(["--background"]) == 0
    told = capsys.readouterr()
    assert told.out.count("installed already") == 2
    assert told.err == "", "viam-server logs that as an error"
    assert len(asked_of(installer)) == 1  # the imports, the first time
    pretend_environment(installer)
    assert installer.main([]) == 0
    with (installer.HERE / "constraints.txt").open("a") as file:
        file.write("another==1.0\n")
    assert not installer.is_installed(set())


def test_it_is_complete_only_once_everything_can_be_imported(installer, capsys):
    pretend_environment(installer, imports=1)
    assert installer.main([]) == 1
    said = capsys.readouterr().err
    assert "error: libodd is missing" in said
    assert "not complete" in said
    assert not installer.DONE.exists()

    pretend_environment(installer, imports=0)
    assert installer.main([]) == 0
    assert installer.is_installed(set())
    assert all("import_check" in line for line in asked_of(installer))  # pip had nothing to do


def test_what_the_tests_need_is_more_than_what_the_demo_needs(installer):
    pretend_environment(installer, extras=("viewer",))
    assert installer.main(["--with", "viewer"]) == 0
    assert installer.is_installed(set())
    assert not installer.is_installed(installer.EXTRAS["dev"])
    assert installer.main(["--with", "dev"]) == 0
    assert installer.is_installed(installer.EXTRAS["viewer"])
    assert any("pip install" in line and ".[dev,viewer]" in line for line in asked_of(installer))


def test_an_environment_without_pip_is_made_anew(installer):
    pretend_environment(installer)
    (command,) = installer.steps(set())
    assert "pip" in command
    installer.PYTHON.write_text("#!/bin/sh\necho 'No module named pip' >&2; exit 1\n")
    assert not installer.is_filled(set())
    first, _ = installer.steps(set())
    assert first[1:] == ("-m", "venv", "--clear", str(installer.VENV))


@pytest.mark.parametrize(
    ("version", "wanted", "works"),
    [
        ("3.10", "", False),
        ("3.12", "", True),
        ("3.15", "", False),
        ("3.10", sys.executable, False),
        (HERE, sys.executable, True),
    ],
)
def test_an_environment_of_another_python_is_made_anew(
    installer, monkeypatch, version, wanted, works
):
    monkeypatch.setenv("PYTHON", wanted)
    pretend_environment(installer, version=version)
    assert installer.environment_works() == works


def test_too_little_disk_space_is_said_before_anything_is_done(installer, capsys):
    installer.MEGABYTES = {**installer.MEGABYTES, "": 1e9}
    assert installer.main([]) == 1
    said = capsys.readouterr().err
    assert "MB are needed" in said
    assert "free some space" in said
    assert not installer.VENV.exists()


def test_headers_and_second_copies_of_libraries_are_removed(installer):
    packages = installer.VENV / "lib" / "python3.12" / "site-packages"
    lib = packages / "cmeel.prefix" / "lib"
    for gone in ("cmeel.prefix/include/a.h", "cmeel.prefix/lib/b.a", "scipy/io/tests/c.py"):
        (packages / gone).parent.mkdir(parents=True, exist_ok=True)
        (packages / gone).write_text("")
    boost = ("libboost_used.so", "u"), ("libboost_log.so", "-"), ("libboost_log.so.1", "-")
    libraries = ("libd.so", "d"), ("libd.so.1", "d"), ("libe.so", "needs libboost_used.so.1")
    for name, content in (*boost, *libraries, ("libboost_wave.so", "needs libboost_log.so.1")):
        (lib / name).write_text(content)
    installer.slim(installer.VENV)
    assert {path.name for path in packages.rglob("*") if not path.is_dir()} == {
        *("libboost_used.so", "libd.so", "libd.so.1", "libe.so")
    }
    assert (lib / "libd.so.1").is_symlink()
    assert [(lib / name).read_text() for name in ("libd.so.1", "libe.so")] == [
        *("d", "needs libboost_used.so.1")
    ]


@pytest.mark.skipif(sys.platform != "linux", reason="only ELF files are cut")
def test_a_library_is_smaller_and_works_without_its_symbols(installer):
    code = "import sys; sys.path.insert(0, sys.argv[1]); import ruckig; print(ruckig.__file__)"
    packages = installer.VENV / "lib" / "python3.12" / "site-packages"
    packages.mkdir(parents=True)
    copy = Path(shutil.copy(importlib.util.find_spec("ruckig").origin, packages))
    with copy.open("ab") as file:  # as much as symbols would take
        file.write(bytes(10_000))
    before = copy.stat().st_size
    installer.slim(installer.VENV)
    assert copy.stat().st_size <= before - 10_000
    said = subprocess.check_output([sys.executable, "-c", code, str(packages)], text=True)
    assert said.strip() == str(copy)


@pytest.mark.parametrize(
    ("said", "then"),
    [
        ("ERROR: ... [Errno 28] No space left on device", "The disk is full"),
        (
            "WARNING: Retrying ... Failed to establish a new connection",
            "The package index was not reached",
        ),
        ("ERROR: ResolutionImpossible", "pip's messages above have the reason"),
    ],
)
def test_a_failure_is_reported_as_what_it_is(installer, said, then):
    if then.startswith("pip") and not installer.has_ready_wheels():
        pytest.skip("this system compiles, and may lack what that takes")
    assert installer.what_to_try(said).startswith(then)


def test_two_installations_do_not_run_at_once(installer, capsys):
    with installer.the_lock(0.0) as first:
        assert first is not None
        with installer.the_lock(0.0) as second:
            assert second is None
        installer.PATIENCE = 0.0
        assert installer.in_foreground(set()) == 1
    assert "another installation is still running" in capsys.readouterr().err
    with installer.the_lock(0.0) as third:
        assert third is not None


def test_a_step_that_hangs_is_ended_with_all_it_started(installer, capsys):
    mark = f"30.0{os.getpid()}"
    begin = time.monotonic()
    with installer.the_lock(0.0) as lock:
        assert installer.run(("sh", "-c", f"sleep {mark} & wait"), 0.2, lock) == (1, "")
    assert time.monotonic() - begin < 20.0
    assert "error: stopped" in capsys.readouterr().err
    deadline = time.monotonic() + 20.0
    while any(mark in command_of(pid) for pid in processes()):  # the kernel takes a moment
        assert time.monotonic() < deadline


@pytest.mark.parametrize(
    ("version", "needs"),
    [((3, 11), "cp311-cp311"), ((3, 12), "cp312-abi3"), ((3, 14), "cp312-abi3")],
)
def test_compiled_wheels_that_came_along_are_counted_for_this_python_alone(
    installer, monkeypatch, version, needs
):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    monkeypatch.setattr(sys, "version_info", version)
    installer.WHEELS.mkdir()
    (installer.WHEELS / "ruckig-0.19.4-cp39-cp39-any.whl").touch()
    assert not installer.has_ready_wheels()
    (installer.WHEELS / f"ruckig-0.19.4-{needs}-any.whl").touch()
    assert installer.has_ready_wheels()


@pytest.mark.parametrize(
    ("platform", "says"),
    [("linux", "apt-get install g++ cmake python3-dev"), ("darwin", "xcode-select --install")],
)
def test_a_missing_compiler_is_named(installer, monkeypatch, platform, says):
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr("platform.machine", lambda: "some")
    monkeypatch.setenv("PATH", str(installer.HERE))
    assert says in installer.what_to_try("")


@pytest.fixture
def tools(tmp_path):
    """A PATH on which there is no Python yet."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in ("sh", "dirname"):
        (folder / name).symlink_to(shutil.which(name))
    return folder


def python(folder, name, *, version, has_venv=True):
    """A Python that says its version, has venv or not, and tells what it is to run."""
    file = folder / name
    file.write_text(
        f"#!{shutil.which('sh')}\n"
        'case "$*" in\n'
        f'*"sys.exit"*) exit {int(not (3, 11) <= version <= (3, 14))} ;;\n'
        f'*"import ensurepip"*) exit {int(not has_venv)} ;;\n'
        f'*"print("*) echo {version[0]}.{version[1]} ;;\n'
        f"*) echo {name} runs $* ;;\n"
        "esac\n"
    )
    file.chmod(0o755)


def ended(tools, script, *arguments, **environment):
    return subprocess.run(
        [tools / "sh", tools.parent / script, *arguments],
        env={"PATH": str(tools), **environment},
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_without_python_the_first_run_says_so_and_succeeds(installer, tools):
    first = ended(tools, "first_run.sh")
    assert first.returncode == 0
    assert "no Python 3.11 to 3.14 was found" in first.stderr
    assert "try: apt-get install python3-venv (as root)" in first.stderr


@pytest.mark.parametrize("name", ["python3.11", "python3.12", "python3.13", "python3.14"])
def test_each_python_that_suits_is_found(installer, tools, name):
    python(tools, "python3", version=(3, 9))
    python(tools, name, version=(3, int(name.partition(".")[2])))
    assert (
        ended(tools, "setup.sh", "--with", "dev").stdout == f"{name} runs install.py --with dev\n"
    )


def test_a_python_without_venv_is_passed_over_and_otherwise_told(installer, tools):
    python(tools, "python3.11", version=(3, 11), has_venv=False)
    setup = ended(tools, "setup.sh")
    assert setup.returncode == 1
    assert "try: apt-get install python3.11-venv (as root)" in setup.stderr
    python(tools, "python3", version=(3, 13))
    assert ended(tools, "setup.sh").stdout == "python3 runs install.py\n"


@pytest.mark.parametrize("version", [(3, 10), (3, 15)])
def test_a_python_that_does_not_suit_is_told_and_leaves_nothing(installer, tools, version):
    python(tools, "python3", version=version)
    python(tools, "mine", version=version)
    python(tools, "python3.12", version=(3, 12))
    setup = ended(tools, "setup.sh", PYTHON="mine")  # what is named is not passed over
    assert setup.returncode == 1
    assert f"mine is Python 3.{version[1]}" in setup.stderr
    (tools / "python3.12").unlink()
    assert f"python3 is Python 3.{version[1]}" in ended(tools, "setup.sh").stderr
    assert not installer.VENV.exists()


def test_the_module_does_not_start_from_an_installation_that_is_not_complete(installer, tools):
    pretend_environment(installer, imports=1)
    (tools / "python3").symlink_to(sys.executable)
    started = ended(tools, "run.sh", "/tmp/no.sock", HOME=str(tools))
    assert started.returncode == 1
    assert "error: libodd is missing" in started.stderr
    assert not any("so101_motion /tmp" in line for line in asked_of(installer))
