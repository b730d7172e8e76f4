import json
from contextlib import nullcontext
from dataclasses import replace
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest
from so101_viewer.panels.film import MovedArm
from so101_viewer.panels.share_panel import FILM, KINDS, RUN, SharePart, content, file_name

from so101_motion.common.geometry import SE3
from so101_motion.files.trajectory_export import Run
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point

NOW = datetime(2026, 11, 21, 19, 30, 5)


@pytest.fixture
def arm():
    limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=20.0)
    trajectory = point_to_point(np.zeros(5), np.full(5, 0.2), limits, 0.01)
    return MovedArm(view=SimpleNamespace(plan=SimpleNamespace(trajectory=trajectory)))


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != FILM])
def test_each_kind_of_file_has_something_in_it_for_a_plan(arm, kind):
    assert len(content(arm, kind)) > 1000


def test_names_of_files_tell_kinds_plans_and_arms_apart(arm):
    ran = replace(arm, run=Run(t=np.array([0.0, 0.1]), q_ref=np.zeros((2, 5)), q=np.zeros((2, 5))))
    kind = "JSON, degrees"
    assert file_name(arm, kind, NOW) == "so101-plan-20261121-193005.json"
    assert file_name(ran, kind, NOW) == "so101-run-20261121-193005.json"
    assert json.loads(content(ran, kind))["schema"] == "so101/run/1"
    assert len({file_name(arm, each, NOW) for each in KINDS}) == len(KINDS)
    name = "so101-plan-20261121-193005-arm-2-b.json"
    assert file_name(arm, kind, NOW, chosen="arm 2/b") == name
    assert file_name(arm, FILM, NOW, chosen="arm 2/b") == "so101-plan-20261121-193005.html"


def test_there_is_no_download_before_a_plan_and_of_the_run_none_before_it_has_run():
    def widget(_label, options=(), **looks):
        return SimpleNamespace(value=next(iter(options), None), **looks)

    gui = SimpleNamespace(
        add_html=lambda html: SimpleNamespace(content=html), add_dropdown=widget, add_button=widget
    )
    context = SimpleNamespace(
        gui=gui,
        tabs=SimpleNamespace(add_tab=lambda _label: nullcontext()),
        on_asked=lambda _button, _order: None,
        leave_open=lambda *_widgets: None,
    )
    page = SimpleNamespace(plan_view=None, ran=None, plan_is_current=False)
    part = SharePart(context, {"": page}, {"": SE3.identity()}, title="Arm")

    def offered():
        assert part.refresh()
        part.show()
        return not part._download.disabled, not part._what.disabled

    assert offered() == (False, False)
    page.plan_view = SimpleNamespace(name="Plan 1")
    assert offered() == (True, False)
    page.ran = (
        page.plan_view,
        SimpleNamespace(
            run=Run(t=np.array([0.0, 0.1]), q_ref=np.zeros((2, 5)), q=np.zeros((2, 5)))
        ),
    )
    part._what.value = RUN
    assert offered() == (True, True)
    assert "The last run, of Plan 1." in part._sentence.content
