"""The module's checks of every call before the SDK sees it."""

from __future__ import annotations

import numpy as np
import pytest
import viam.utils
from viam.utils import dict_to_struct, struct_to_dict

from so101_motion.viam.requests.request_guard import convert_answers_fast


@pytest.fixture(autouse=True)
def fast(monkeypatch):
    for name in ("SupportsFloat", "SupportsBytes"):
        monkeypatch.setattr(viam.utils, name, getattr(viam.utils, name))
    convert_answers_fast()


def test_every_kind_of_value_arrives():
    answer = {
        "number": 0.5,
        "count": 3,
        "measured": np.float64(0.25),
        "single": np.float32(0.5),
        "ticks": np.int64(2047),
        "yes": True,
        "name": "elbow_flex",
        "rows": [[1, 2.5], ["a", False]],
        "inner": {"x": [1.0]},
    }
    arrived = struct_to_dict(dict_to_struct(answer))
    assert arrived == answer
    assert arrived["yes"] is True
