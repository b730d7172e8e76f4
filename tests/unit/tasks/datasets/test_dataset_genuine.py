"""Data sets that LeRobot itself wrote; see ``tests/data/lerobot``."""

import json
import tarfile
from pathlib import Path

import pytest
from harness.lerobot_data import pa  # noqa: F401  # skips where pyarrow is not installed

from so101_motion.common.errors import ConfigError
from so101_motion.tasks.datasets import check_data_set, open_data_set

ARCHIVES = Path(__file__).parents[3] / "data" / "lerobot"
WHOLE = (
    "0.3.3-swing", "0.4.2-swing", "0.4.4-swing", "0.4.4-other-units", "0.6.1-two", "0.6.1-lekiwi",
)  # fmt: skip


def unpacked(name, folder):
    with tarfile.open(ARCHIVES / f"{name}.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder / name


@pytest.mark.parametrize("name", WHOLE)
def test_the_units_of_a_genuine_data_set_are_found_and_nothing_else_is(tmp_path, name):
    root = unpacked(name, tmp_path)
    expected = json.loads((root / "expected.json").read_text())
    for side in ("left", "right") if len(expected["arms"]) == 2 else ("",):
        report = check_data_set(open_data_set(root, side=side))
        assert (report.units.kind, report.certainty) == (expected["units"], "certain")
        assert (report.frames, report.moments) == (60, ())


def test_a_genuine_recording_that_was_killed_before_finalize_is_named(tmp_path):
    root = unpacked("0.6.1-killed", tmp_path)
    with pytest.raises(ConfigError, match="before LeRobot finished the file"):
        check_data_set(open_data_set(root))
