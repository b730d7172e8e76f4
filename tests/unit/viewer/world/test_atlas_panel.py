"""An atlas's tab sends its cubes, and a click on a cube makes its pose the goal."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from so101_viewer.page.page_context import PageContext
from so101_viewer.server.guarded_server import start_guarded
from so101_viewer.world.atlas_panel import AtlasPart

from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.sweeps import Atlas, ReachSweep, run_sweep
from so101_motion.tasks.sweeps.atlas_view import Shown, voxels


@dataclass(frozen=True, slots=True, kw_only=True)
class NotedContext(PageContext):
    """A context whose cubes are clicked by the test."""

    handlers: list = field(default_factory=list)

    def handler(self, command_for):
        self.handlers.append(command_for)
        return PageContext.handler(self, command_for)

    def click(self, number):
        self.handlers[-1](SimpleNamespace(instance_index=number))()


@pytest.fixture
def context():
    server = start_guarded(port=0)
    viser = server.viser
    yield NotedContext(
        server=viser, tabs=viser.gui.add_tab_group(), post=lambda command: command(), workers=None
    )
    server.close()


def test_a_click_on_a_cube_makes_its_pose_the_goal(context, tmp_path):
    run_sweep(ReachSweep(spacing=0.08), tmp_path / "atlas")
    atlas, goals = Atlas.read(tmp_path / "atlas"), []
    part = AtlasPart(context, atlas, goals.append)
    assert part.refresh()
    part.show()
    assert not part.refresh()
    expected = voxels(atlas, Shown(axis="y"))  # a slice, so that the arm is seen
    assert part._cubes.batched_positions == pytest.approx(expected.p, abs=1e-6)
    context.click(3)
    context.click(10**6)  # was sent for cubes that are gone
    context.click(None)
    (q,) = goals
    assert RobotModel.load().frame(np.array(q)).p == pytest.approx(expected.p[3], abs=1e-5)
