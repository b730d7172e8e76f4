"""An atlas's tab sends its cubes, and a click on a cube makes its pose the goal."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from so101_viewer.page.page_context import ArmContext
from so101_viewer.server.guarded_server import start_guarded
from so101_viewer.world.atlas_panel import AtlasPart

from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.sweeps import Atlas, ReachSweep, run_sweep
from so101_motion.tasks.sweeps.atlas_view import Shown, voxels


@dataclass(frozen=True, slots=True, kw_only=True)
class NotedContext(ArmContext):
    """A context whose cubes are clicked by the test."""

    picks: list = field(default_factory=list)

    def on_pick_one(self, node, command):
        self.picks.append((node, command))


@pytest.fixture
def context():
    server = start_guarded(port=0)
    viser = server.viser
    yield NotedContext(
        server=viser,
        tabs=viser.gui.add_tab_group(),
        post=lambda command: command(),
        workers=None,
        rig=SimpleNamespace(),
    )
    server.close()


def test_a_click_on_a_cube_makes_its_pose_the_goal(context, tmp_path):
    run_sweep(ReachSweep(spacing=0.08), tmp_path / "atlas")
    atlas, goals = Atlas.read(tmp_path / "atlas"), []
    part = AtlasPart(context, atlas, goals.append)
    assert part.refresh()
    part.show()
    assert not part.refresh()
    ((cubes, pick),) = context.picks
    expected = voxels(atlas, Shown(axis="y"))  # a slice, so that the arm is seen
    assert cubes.batched_positions == pytest.approx(expected.p, abs=1e-6)
    pick(3)
    pick(10**6)  # was sent for cubes that are gone
    (q,) = goals
    assert RobotModel.load().frame(np.array(q)).p == pytest.approx(expected.p[3], abs=1e-5)
