"""What the tests of the command line share."""

import json

import pytest
from click.testing import CliRunner

from so101_motion.cli.verbs import main


@pytest.fixture(autouse=True)
def data(tmp_path, monkeypatch):
    """The folder of the user's files, which is empty; and no arm in the environment."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    for name in ("SO101_PORT", "SO101_MACHINE", "SO101_API_KEY", "SO101_API_KEY_ID"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "data" / "so101_motion"


@pytest.fixture
def so101():
    """Runs a command line: words with blanks between them, then words that may have blanks."""

    def run(line, *words, **how):
        return CliRunner().invoke(main, [*line.split(), *map(str, words)], **how)

    return run


@pytest.fixture
def told(so101):
    """What a command line tells programs, if it succeeds."""

    def run(line, *words, **how):
        result = so101(line, *words, "--json", **how)
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    return run
