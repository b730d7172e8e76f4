"""Guided paths as files."""

import json

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.tasks.guided import GuidedPath, files

WAVE = GuidedPath(
    t=[0.0, 0.5, 1.25],
    q=np.radians([[0, -20, 30, 5, 0], [10, -20, 30, 5, 0], [0, -20, 30, 5, 90]]),
    aperture=[0.25, 0.5, 1.0],
)


def changed(file, **changes):
    content = json.loads(file.read_text())
    content.update(changes)
    file.write_text(json.dumps({key: value for key, value in content.items() if value is not None}))


def test_a_written_file_reads_back_the_same(tmp_path):
    file = files.file_of(tmp_path / "paths", "wave")
    files.write(WAVE, file)
    read = files.read(file)
    np.testing.assert_allclose(read.t, WAVE.t)
    np.testing.assert_allclose(read.q, WAVE.q, atol=1e-6)
    np.testing.assert_allclose(read.aperture, WAVE.aperture)
    assert [kept.name for kept in files.listed(file.parent)] == ["wave"]
    content = json.loads(file.read_text())
    assert content["schema"] == "so101/guided-path/1"
    assert content["joints"][1] == "shoulder_lift"
    assert content["q_deg"][1][0] == 10.0
    assert [each.name for each in file.parent.iterdir()] == ["wave.json"], "nothing is left behind"


def test_points_that_a_file_cannot_tell_apart_do_not_make_it_unreadable(tmp_path):
    t = [0.0, 1.1e-16, 0.01, 0.01004, 0.5]
    file = tmp_path / "wave.json"
    files.write(GuidedPath(t=t, q=np.outer(t, np.ones(5))), file)
    np.testing.assert_allclose(files.read(file).t, [0.0, 0.01, 0.5])


def test_an_arm_without_a_jaw_has_no_apertures(tmp_path):
    file = tmp_path / "wave.json"
    files.write(GuidedPath(t=WAVE.t, q=WAVE.q), file)
    assert "aperture_percent" not in json.loads(file.read_text())
    assert files.read(file).aperture is None


def test_nobody_else_s_file_is_removed(tmp_path):
    (tmp_path / "arm.json").write_text("{}")
    with pytest.raises(ConfigError, match="is not a guided path file"):
        files.set_aside(tmp_path / "arm.json")
    assert files.listed(tmp_path) == []


def test_a_name_that_is_not_there_is_answered_with_those_that_are(tmp_path):
    files.write(WAVE, tmp_path / "wave.json")
    with pytest.raises(ConfigError, match="there are: wave"):
        files.read(tmp_path / "wafe.json")


@pytest.mark.parametrize("name", ["", "../wave", "a/b", ".hidden", 3, None, "x" * 90])
def test_an_invalid_name_is_refused(tmp_path, name):
    with pytest.raises(ConfigError, match="letters, digits"):
        files.file_of(tmp_path, name)


@pytest.mark.parametrize("key", ["time_s", "q_deg", "aperture_percent"])
def test_one_file_with_a_number_beyond_all_floats_does_not_hide_the_others(tmp_path, key):
    files.write(WAVE, tmp_path / "good.json")
    files.write(WAVE, tmp_path / "bad.json")
    changed(tmp_path / "bad.json", **{key: [10**400]})
    with pytest.raises(ConfigError, match=key):
        files.read(tmp_path / "bad.json")
    assert [kept.name for kept in files.listed(tmp_path)] == ["good"]


def test_the_last_deleted_paths_can_be_restored_also_of_one_name(tmp_path):
    file = files.file_of(tmp_path, "wave")
    kept = []
    for length in range(1, files.KEPT + 3):
        files.write(WAVE.taken(slice(0, 1 + length % 2)), file)
        kept.append(files.set_aside(file))
        assert files.listed(tmp_path) == []
    for lost in kept[:2]:
        with pytest.raises(ConfigError, match="is gone"):
            files.restore(tmp_path, lost)
    assert files.restore(tmp_path, kept[3]) == file
    assert len(files.read(file)) == 1
    with pytest.raises(ConfigError, match="is there already"):
        files.restore(tmp_path, kept[2])
    assert files.set_aside(file) == f"{files.KEPT + 3} wave"
    assert files.restore(tmp_path, kept[2]) == file
    assert len(files.read(file)) == 2
