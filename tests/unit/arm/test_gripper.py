import math
from dataclasses import replace

import pytest

from so101_motion.arm import gripper as gripper_module
from so101_motion.arm.gripper import GENTLEST, JAW_CLOSED, JAW_OPEN, SQUEEZE, Gripper
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import (
    BusError,
    ConfigError,
    FollowingError,
    Interrupted,
    MotionError,
    NotHolding,
)
from so101_motion.common.units import to_rad
from so101_motion.control.joint_group import Tolerances


class TroubledArm:
    """Mixed into a simulated arm: it can report alarms, and lose answers of the jaw."""

    alarms, lost = None, 0

    def read(self):
        self.lost, is_lost = max(self.lost - 1, 0), self.lost > 0
        silent = frozenset({"gripper"} if is_lost else ())
        return replace(super().read(), alarms=self.alarms or {}, unanswered=silent)


@pytest.fixture
def rig(make_sim, taped_arm, clock):
    arm = type("Arm", (TroubledArm, taped_arm), {})(clock, q_jaw=JAW_CLOSED)
    sim = make_sim(arm, jaw_tolerances=Tolerances(settle_timeout=0.4, following_error=0.08))
    sim.executor.start()
    return sim


@pytest.fixture
def gripper(rig):
    return Gripper(rig.executor)


def meet(rig, gripper, start, opened=0.5):
    """Open, begin a motion, and have something in its way; the motion."""
    rig.after(3.0, gripper.move(opened, wait=False).future)
    motion = start()
    rig.clock.advance(0.1)
    rig.arm.jam("gripper")
    return motion


def grab(gripper):
    return lambda: gripper.grab(wait=False)


def test_it_opens_as_far_as_it_is_told(rig, gripper):
    rig.after(3.0, gripper.move(0.5, wait=False).future)

    assert gripper.aperture == pytest.approx(0.5, abs=1e-3)
    assert rig.state.q_jaw == pytest.approx((JAW_CLOSED + JAW_OPEN) / 2, abs=1e-3)
    with pytest.raises(ConfigError):
        gripper.move(1.1, wait=False)
    gripper.closed, gripper.opened = to_rad(0.0), to_rad(50.0)
    rig.after(3.0, gripper.move(1.0, wait=False).future)
    assert rig.state.q_jaw == pytest.approx(to_rad(50.0), abs=1e-3)


def test_a_jaw_that_does_not_answer_is_not_moved_and_told_as_that(rig, gripper, clock):
    rig.arm.lost = 10**6
    clock.advance(0.1)
    refused = gripper.move(0.5, wait=False).future
    clock.advance(0.1)
    with pytest.raises(BusError, match="gripper does not answer; check its cable"):
        refused.result(timeout=0)
    rig.arm.lost = 1  # one answer
    clock.advance(0.0)
    rig.after(3.0, gripper.move(0.5, wait=False).future)
    gripper.is_there = False
    with pytest.raises(NotHolding, match="gripper did not answer when the arm was opened"):
        gripper.move(0.1, wait=False)


def test_a_grab_that_meets_nothing_closes_also_by_way_of_a_jam_near_its_end(rig, gripper):
    rig.after(3.0, gripper.move(0.5, wait=False).future)
    rig.after(3.0, gripper.grab(wait=False).future)
    assert gripper.aperture == pytest.approx(0.0, abs=1e-3)
    assert not gripper.is_holding
    gripper.closed = JAW_CLOSED - to_rad(1.0)
    rig.arm.jam("gripper")
    rig.after(3.0, gripper.grab(wait=False).future)
    assert not gripper.is_holding


def test_a_grab_that_meets_something_presses_a_little_and_holds(rig, gripper):
    rig.after(3.0, meet(rig, gripper, grab(gripper)).future)

    assert gripper.is_holding
    assert rig.state.q_jaw - rig.arm.jaw_goals[-1] == pytest.approx(SQUEEZE, abs=1e-6)
    rig.arm.unjam("gripper")
    rig.clock.advance(1.0)
    assert not gripper.is_holding


@pytest.mark.parametrize("starts", [Gripper.grab, Gripper.move])
def test_a_jaw_that_was_only_late_closes_all_the_way(rig, gripper, starts):
    rig.after(3.0, gripper.move(0.9, wait=False).future)
    closing = starts(gripper, 0.1, wait=False)
    for _ in range(2):  # as often as servos or their bus falter
        rig.clock.advance(0.15)
        rig.arm.jam("gripper")
        while rig.executor.state.mode.value != "stopping":
            rig.clock.advance(0.01)
        rig.arm.unjam("gripper")
    rig.after(4.0, closing.future)

    assert gripper.aperture == pytest.approx(0.1, abs=1e-3)
    assert not gripper.is_holding


def test_a_jaw_that_ran_past_where_it_was_to_press_closes_on(rig, gripper):
    grabbing = meet(rig, gripper, grab(gripper))
    for mode in ("stopping", "moving"):
        while rig.executor.state.mode.value != mode:
            rig.clock.advance(0.01)
    rig.clock.advance(0.02)  # it presses
    rig.arm._q[5] -= 2.0 * SQUEEZE
    rig.after(3.0, grabbing.future)

    assert gripper.is_holding
    assert rig.state.q_jaw - rig.state.q_jaw_ref == pytest.approx(SQUEEZE, abs=1e-3)


def test_a_grip_presses_as_gently_as_it_is_told_also_while_it_holds(rig, gripper):
    gripper.set_force(GENTLEST)
    rig.after(3.0, meet(rig, gripper, grab(gripper)).future)
    for force in (GENTLEST, 1.0, 0.8):
        gripper.set_force(force)
        rig.clock.advance(1.0)
        assert rig.state.q_jaw - rig.arm.jaw_goals[-1] == pytest.approx(force * SQUEEZE, abs=1e-6)
        assert gripper.is_holding
    for force in (0.0, 1.5, math.nan):
        with pytest.raises(ConfigError, match="force"):
            gripper.set_force(force)


def test_a_stop_of_a_grab_that_has_just_met_something_presses_no_further(rig, gripper):
    grabbing = meet(rig, gripper, grab(gripper))
    while not rig.executor.state.jaw_moving or rig.executor.state.mode.value != "stopping":
        rig.clock.advance(0.01)  # it has met it, and slows down
    stopped = gripper.start_stop()
    rig.clock.advance(2.0)
    assert stopped.exception(timeout=0) is None
    assert isinstance(grabbing.future.exception(timeout=0), Interrupted)
    assert rig.state.q_jaw - rig.state.q_jaw_ref < 0.5 * SQUEEZE


@pytest.mark.parametrize(("opened", "to", "grips"), [(0.5, 0.1, True), (0.3, 0.9, False)])
def test_a_move_that_meets_something_says_so_and_grips_it_if_it_closes(
    rig, gripper, opened, to, grips
):
    moving = meet(rig, gripper, lambda: gripper.move(to, wait=False), opened)
    assert isinstance(rig.error_after(3.0, moving.future), FollowingError)
    assert gripper.is_holding is grips
    if grips:
        assert rig.state.q_jaw - rig.state.q_jaw_ref == pytest.approx(SQUEEZE, abs=1e-3)


# Following


def lead(rig, jaw, aperture, seconds):
    for _ in range(round(seconds / rig.dt)):
        jaw.aim(aperture)
        rig.clock.advance(rig.dt)


def gripping(rig, gripper):
    """A following that has closed on something."""
    jaw = gripper.follow()
    lead(rig, jaw, 0.6, 2.0)
    lead(rig, jaw, 0.0, 0.1)
    rig.arm.jam("gripper")
    lead(rig, jaw, 0.0, 1.5)
    return jaw


def test_the_jaw_follows_apertures_and_rests_when_they_cease(rig, gripper):
    jaw = gripper.follow()
    assert jaw.aim(0.6) == 0.6
    lead(rig, jaw, 0.6, 2.0)
    assert gripper.aperture == pytest.approx(0.6, abs=1e-3)
    assert jaw.aim(-1.5) == 0.0
    assert jaw.aim(-7.0, most=math.inf) == 0.0
    with pytest.raises(ConfigError):
        jaw.aim(math.nan)
    rig.clock.advance(2.0)
    assert gripper.aperture > 0.1, "nobody repeated it"
    rig.after(0.5, jaw.close())
    with pytest.raises(MotionError, match="is over"):
        jaw.aim(0.5)


def test_a_stop_of_a_jaw_that_grips_ends_its_following(rig, gripper):
    jaw = gripping(rig, gripper)
    rig.after(0.5, gripper.start_stop())
    assert jaw.future.exception(timeout=0).by == "stop"
    assert gripper.is_holding, "and it holds on"


@pytest.fixture
def stopped_at_once(monkeypatch):
    """A stop on another thread comes just before a motion of the jaw begins."""

    class Stopped(Motion):
        def begin(self):
            self.interrupt("stop")
            return super().begin()

    monkeypatch.setattr(gripper_module, "Motion", Stopped)


@pytest.mark.usefixtures("stopped_at_once")
def test_a_jaw_that_is_stopped_before_it_follows_does_not_follow(rig, gripper):
    before, called = gripper.aperture, []

    def widen(jaw):
        called.append(jaw.aim(1.0))

    with pytest.raises(Interrupted):
        gripper.follow(each=widen, stale_after=None)
    rig.clock.advance(1.0)
    assert called == []
    assert gripper.aperture == before


def test_a_jaw_that_grips_does_not_open_after_its_following_has_ended(rig, gripper):
    jaw = gripping(rig, gripper)

    class Aperture(float):
        def __float__(self):  # a stop on another thread, after the following was looked at
            jaw.interrupt("stop")
            return super().__float__()

    with pytest.raises(Interrupted):
        jaw.aim(Aperture(1.0))
    assert gripper.is_holding
