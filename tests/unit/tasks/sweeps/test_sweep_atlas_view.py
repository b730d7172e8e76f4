"""The picture of an atlas shows its values, and every colour scale tells good from bad."""

import numpy as np
import pytest

from so101_motion.tasks.sweeps import Atlas, ReachSweep, run_sweep
from so101_motion.tasks.sweeps.atlas_view import FIGURES, Shown, in_words, shades, voxels


@pytest.fixture(scope="module")
def atlas(tmp_path_factory):
    folder = tmp_path_factory.mktemp("atlas") / "out"
    run_sweep(ReachSweep(spacing=0.06), folder)
    return Atlas.read(folder)


def test_every_cube_is_a_point_that_can_be_reached(atlas):
    seen = voxels(atlas, Shown())
    assert 50 < len(seen.rows) < seen.total == atlas.summary()["reachable"]
    for p in seen.p:
        assert atlas.at(*p.tolist()).reachable


def test_a_slice_and_a_threshold_take_away(atlas):
    cut = voxels(atlas, Shown(axis="y", at=0.01))
    assert np.all(np.abs(cut.p[:, 1]) < 1e-9)
    assert cut.total == len(cut.rows)  # all of a slice can be seen
    strong = voxels(atlas, Shown(axis="y", at_least=0.6))
    assert 0 < strong.total < cut.total
    assert np.all(atlas.rows["torque_left"][strong.rows] >= 0.6)


@pytest.mark.parametrize("figure", FIGURES)
def test_colours_go_from_violet_to_yellow(atlas, figure):
    of = FIGURES[figure]
    bad, good = shades(figure, np.array([of.low - 1.0, of.high + 1.0])).tolist()
    assert (bad, good) == ([68, 1, 84], [253, 231, 37])
    assert len(voxels(atlas, Shown(figure=figure)).colours) > 50


def test_one_answer_has_words(atlas):
    p = voxels(atlas, Shown()).p[0]
    reach = atlas.at(*p.tolist())
    assert f"{reach.ways} ways" in in_words(reach, p)
