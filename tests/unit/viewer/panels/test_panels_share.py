import json
from dataclasses import replace
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest
from so101_viewer.panels.film import MovedArm
from so101_viewer.panels.share import FILM, KINDS, SharedMotion, content, file_name, kind_called

from so101_motion.files.trajectory_export import LeRobot, Run
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point

NOW = datetime(2026, 11, 21, 19, 30, 5)
FILES = [kind for kind in KINDS if kind is not FILM]


@pytest.fixture
def subject():
    limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=20.0)
    trajectory = point_to_point(np.zeros(5), np.full(5, 0.2), limits, 0.01)
    view = SimpleNamespace(plan=SimpleNamespace(trajectory=trajectory))
    return SharedMotion(
        arms={"": MovedArm(view=view)},
        chosen="",
        lerobot=LeRobot(aperture=0.5),
        title="Arm",
    )


@pytest.mark.parametrize("kind", FILES, ids=lambda kind: kind.label)
def test_each_kind_of_file_has_something_in_it_for_a_plan(subject, kind):
    data = content(subject, kind)
    names_of_lerobot = b"wrist_roll.pos" in data
    assert names_of_lerobot is kind.lerobot
    assert len(data) > 1000


def test_a_run_is_told_apart_from_its_plan_by_name_and_content(subject):
    run = Run(t=np.array([0.0, 0.1]), q_ref=np.zeros((2, 5)), q=np.zeros((2, 5)))
    kind = kind_called("JSON, degrees")
    ran = replace(subject, arms={"": replace(subject.arm, run=run)})
    assert file_name(subject, kind, NOW) == "so101-plan-20261121-193005.json"
    assert file_name(ran, kind, NOW) == "so101-run-20261121-193005.json"
    assert json.loads(content(ran, kind))["schema"] == "so101/run/1"


def test_names_of_files_tell_kinds_apart(subject):
    assert len({file_name(subject, kind, NOW) for kind in KINDS}) == len(KINDS)


def test_a_table_of_one_of_several_arms_says_which(subject):
    arms = {"left": subject.arm, "arm 2/b": subject.arm}
    several = replace(subject, arms=arms, chosen="arm 2/b")
    assert file_name(several, kind_called("JSON, degrees"), NOW) == (
        "so101-plan-20261121-193005-arm-2-b.json"
    )
    assert file_name(several, FILM, NOW) == "so101-plan-20261121-193005.html"


def test_an_unknown_kind_is_the_film():
    assert kind_called("<b>") is FILM
