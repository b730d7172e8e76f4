"""Option values are refused before anything is done."""

import threading

import pytest
from harness.command_line import refused


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty folder, in which nothing has been made afterwards."""
    (tmp_path / "work" / "folder.json").mkdir(parents=True)
    (tmp_path / "work" / "there.json").write_text("{}")
    monkeypatch.chdir(tmp_path / "work")
    yield tmp_path / "work"
    assert sorted(path.name for path in (tmp_path / "work").iterdir()) == [
        "folder.json", "there.json",
    ]  # fmt: skip
    assert (tmp_path / "work" / "there.json").read_text() == "{}"


@pytest.fixture
def no_arm(monkeypatch):
    """An arm must not even be opened."""

    start = threading.Thread.start

    def checked(thread):
        assert not thread.name.startswith("so101-"), "an arm was opened first"
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", checked)


@pytest.mark.usefixtures("no_arm")
@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("plan --sim --pose ready --out x.xyz", ".csv, .json, .mcap"),
        ("plan --sim --pose ready --out none/x.csv", "no folder 'none'"),
        ("plan --sim --pose ready --out folder.json", "is a directory"),
        ("plan --sim --pose ready --html x.mp4", "must end with .html"),
        ("plan --sim --pose ready --scene none.json", "does not exist"),
        ("plan --sim --pose ready --scene there.json --speed 181", "3 to 180"),
        ("move --sim --pose ready --acceleration nan", "not a usable number"),
        ("move --sim --xyz 250 0 60", "with commas, without spaces: 250,0,60"),
        ("doctor --sim --report none/x.md", "no folder 'none'"),
        ("guide record --sim --yes none/x.json", "no folder 'none'"),
        ("guide record --sim --yes there.json", "is there already"),
        ("guide record --sim --yes x.csv", "must end with .json"),
        ("guide record --sim --yes x.json --seconds nan", "not a usable number"),
        ("guide replay --sim --yes none.json", "does not exist"),
        ("guide replay --sim --yes there.json --tolerance nan", "not a usable number"),
        ("teleop --leader /dev/ttyACM0", "--follower"),
        ("teleop --leader /dev/x --follower /dev/x --yes", "two arms"),
        ("teleop --leader sim --follower sim --scale 1,2", "5 of them"),
        ("teleop --leader sim --follower sim --scale big", "neither a number"),
        ("teleop --leader sim --follower sim --speed 999", "180"),
        ("teleop --leader sim --follower sim --yes --record x.xlsx", ".csv or .mcap"),
        ("teleop --leader sim --follower sim --yes --record none/x.csv", "no folder 'none'"),
        ("teleop --leader sim --follower sim --yes --no-guard --scene there.json", "for the guard"),
        ("teleop --leader sim --follower sim --yes --fps 0", "0.1 to 1000"),
        ("calibrate --events none/x", "No such file"),
        ("setup --web --repair", "--web works only with"),
        ("emulate --link none/x", "no folder 'none'"),
        ("emulate --link there.json", "is not a link"),
        ("emulate --loss 2", "0 to 1"),
    ],
)
def test_impossible_values_are_refused_at_once(so101, line, says):
    assert says in refused(so101(line))


def test_a_folder_in_which_nobody_may_write_is_named(so101, folder, monkeypatch):
    monkeypatch.setattr("os.access", lambda *_: False)  # root may write anywhere
    assert "no file can be written" in refused(so101("plan --sim --pose ready --out x.csv"))
