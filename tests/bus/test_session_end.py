"""How an arm is left at the end of a session; on emulated servos, watched by the referee."""

from contextlib import ExitStack, suppress

import numpy as np
import pytest
from harness.emulated_rig import MIDDLES_DEG, hardware_bench
from harness.random_scenes import obstacle

from so101_motion.common.errors import Interrupted, MotionError, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.named_poses import POSES
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.session_end import leave

READY_DEG = np.array([0.0, -45.0, 45.0, 60.0, 0.0])
HOME_DEG, REST_DEG = (np.degrees(POSES[i].q) for i in (0, 2))


@pytest.fixture
def bench(tmp_path):
    start = np.radians(READY_DEG + MIDDLES_DEG)
    with hardware_bench(tmp_path, q_start=(*start, 0.5)) as bench:
        yield bench


def leaving(bench, rig, how, **more):
    leave(rig, how, None, waiter=lambda future, within: bench.finish(future, within), **more)


def off(bench, rig, wanted_deg):
    return float(np.abs(bench.arm_deg(rig) - wanted_deg).max())


def closing_by(call):
    stack = ExitStack()
    stack.callback(call)
    return stack


def holds(bench):
    return bool(bench.world.servo("shoulder_lift").drive.torque)


def test_it_goes_home_around_what_is_in_the_way_and_holds(bench):
    rig = bench.open()
    box = obstacle("box", (0.04, 0.04, 0.1), (0.27, 0.0, 0.15))
    rig.arm.scene = Scene(obstacles=(box,))
    leaving(bench, rig, "home")
    assert off(bench, rig, HOME_DEG) < 1.0
    assert not rig.arm.newest[1].report.straight
    assert holds(bench)


def test_it_is_parked_lowered_and_let_go_of_and_does_not_drop(bench):
    rig = bench.open()
    leaving(bench, rig, "park")
    assert rig.arm.state.mode is Mode.LIMP
    assert off(bench, rig, REST_DEG) < 27.0, "lowered from rest until it lies"
    here = bench.q_deg
    bench.advance(2.0)
    assert np.abs(bench.q_deg - here).max() < 8.0


def test_a_pose_that_is_saved_as_park_is_the_park_pose(bench):
    SavedPoses().save("park", np.radians(np.add(READY_DEG, (20, 0, 0, 0, 0))))
    rig = bench.open()
    with pytest.raises(MotionError, match="the way takes"):
        leaving(bench, rig, "park", within=0.0)
    assert np.degrees(rig.arm.newest[1].q_goal[0]) == pytest.approx(20.0)


def test_a_stop_on_the_way_ends_it_and_the_arm_holds_there(bench):
    rig = bench.open()
    stops = iter([rig.arm.start_stop])

    def stopped_half_way(future, within):
        for stop in stops:
            bench.under_way(rig.arm.newest_motion, rig, 0.6)
            stop()
        bench.finish(future, within)

    with pytest.raises(Interrupted, match="stop"):
        leave(rig, "park", None, waiter=stopped_half_way)
    assert holds(bench)
    assert off(bench, rig, READY_DEG) > 1.0
    here = bench.arm_deg(rig)
    bench.advance(2.0)
    assert off(bench, rig, here) < 1.0
    assert off(bench, rig, REST_DEG) > 10.0


def test_a_limp_arm_is_left_limp_where_it_is(bench):
    rig = bench.open()
    bench.finish(rig.executor.release())
    leaving(bench, rig, "park")
    assert rig.arm.state.mode is Mode.LIMP
    assert rig.arm.newest is None, "nothing was planned"


def test_a_way_that_takes_too_long_or_does_not_exist_is_not_begun(bench):
    rig = bench.open()
    with pytest.raises(MotionError, match=r"the way takes \d.\d s, 0.5 s are allowed"):
        leaving(bench, rig, "home", within=0.5)
    around_home = obstacle("box", (0.1, 0.1, 0.1), (0.36, 0.0, 0.23))
    rig.arm.scene = Scene(obstacles=(around_home,))
    with pytest.raises(So101Error, match="box"):
        leaving(bench, rig, "home")
    assert off(bench, rig, READY_DEG) < 1.0
    assert holds(bench)


def test_after_an_error_it_holds_and_says_so(bench):
    rig, told = bench.open(), []
    rig.at_end, rig.on_left = "home", told.append
    with suppress(MotionError), closing_by(rig.leave):
        raise MotionError("hit something")
    (sentence,) = told
    assert sentence.startswith("home at the end: something went wrong before")
    rig.leave()
    assert off(bench, rig, READY_DEG) < 1.0


def test_closing_a_share_moves_nothing_while_another_uses_the_arm(bench):
    first, second = bench.open(), bench.open()
    first.at_end = "home"
    bench.shut(first)
    bench.advance(0.5)
    assert off(bench, second, READY_DEG) < 1.0


def test_what_a_port_is_configured_for_is_done_once(bench, monkeypatch):
    rig = bench.open(at_end="home")
    port = rig._shared
    monkeypatch.setattr(
        "so101_motion.rig.shared_port.leave",
        lambda rig, how, zeros, within: leaving(bench, rig, how, within=within),
    )
    port.leave_as_configured()
    assert off(bench, rig, HOME_DEG) < 1.0
    bench.finish(bench.go(rig, *READY_DEG))
    port.leave_as_configured()
    assert off(bench, rig, READY_DEG) < 1.0
