"""What the tests of the command line share."""

import json

import pytest
from click.testing import CliRunner

from so101_motion.cli.verbs import main


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
