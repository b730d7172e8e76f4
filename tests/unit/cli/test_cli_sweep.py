"""``so101 sweep``: what it prints, and that it goes on."""

import json

import pytest
from click.testing import CliRunner

from so101_motion.cli import main


def sweep(*arguments):
    return CliRunner().invoke(main, ["sweep", *arguments])


@pytest.mark.slow
def test_reach_ends_with_the_sha256_and_is_not_computed_twice(tmp_path):
    asked = ("reach", "--spacing-mm", "100", "--out", str(tmp_path / "atlas"), "--workers", "1")
    first = sweep(*asked)
    assert first.exit_code == 0, first.output
    assert "reachable volume" in first.stdout
    name, value = first.stdout.splitlines()[-1].split()
    assert (name, len(value)) == ("sha256", 64)
    second = json.loads(sweep(*asked, "--json").stdout)
    assert (second["computed"], second["sha256"]) == (0, value)
    third = sweep(*asked, "--payload-g", "100")
    assert third.exit_code == 2
    assert "its payload is 0.0, and 0.1 is asked for" in third.stderr


def test_workers_and_dask_exclude_each_other(tmp_path):
    both = sweep("reach", "--out", str(tmp_path), "--workers", "1", "--dask", "tcp://x:1")
    assert both.exit_code == 2
    assert "not both" in both.output
