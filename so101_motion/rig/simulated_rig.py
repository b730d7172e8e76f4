"""Open simulated arms and grippers."""

from __future__ import annotations

import atexit

from so101_motion.arm.gripper import JAW_CLOSED
from so101_motion.common.clock import Clock, MonotonicClock
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.units import to_rad
from so101_motion.drivers.simulated import SimArm
from so101_motion.planning.collision.scene import Scene, checked_scene
from so101_motion.rig.rig import Rig
from so101_motion.rig.things import keep_up, things_in


def open_simulated(
    *,
    speed: float = to_rad(90.0),
    acceleration: float = to_rad(100.0),
    scene: Scene | None = None,
    q_start: Array | None = None,
    q_jaw_start: float = JAW_CLOSED,
    clock: Clock | None = None,
) -> Rig:
    """Open a simulated arm and gripper, ready to move; starts the planning process.

    Its jaw can grip the items of its scene; ``Rig.things`` knows where these truly are.

    Args:
        speed: Joint speed cap [rad/s].
        acceleration: Joint acceleration cap [rad/s^2].
        scene: What is around it and in its hand; just the floor if not given.
        q_start: Joint angles at the start, shape (5,), [rad]; zeros by default.
        q_jaw_start: Jaw angle at the start [rad].
        clock: The rig's clock; the real time by default.

    Raises:
        ConfigError: The speed or acceleration is outside its range.
    """
    is_real_time = clock is None
    clock, scene = clock or MonotonicClock(), checked_scene(scene or Scene())
    things = things_in(scene)
    driver = SimArm(clock, q=q_start, q_jaw=q_jaw_start, things=things)
    rig = Rig(driver, clock=clock, speed=speed, acceleration=acceleration, scene=scene)
    rig.things, rig.gripper.feels = things, bool(scene.items)

    def follow(before: Scene, now: Scene) -> None:
        keep_up(things, before, now)
        rig.gripper.feels = rig.gripper.feels or bool(now.items)

    def seen(name: str) -> SE3 | None:
        return things.where(name) if name in things.names else None

    rig.arm.on_scene, rig.picker.seen = follow, seen
    rig.warm_up()
    if is_real_time:
        atexit.register(rig.close)  # or a prompt that ends in mid-motion prints what it leaks
    return rig


def open_simulated_gripper(*, q_jaw_start: float = JAW_CLOSED, clock: Clock | None = None) -> Rig:
    """Open a simulated gripper on an arm that stands still; starts no planning process.

    Args:
        q_jaw_start: Jaw angle at the start [rad].
        clock: The rig's clock; the real time by default.
    """
    clock = clock or MonotonicClock()
    return Rig(
        SimArm(clock, q_jaw=q_jaw_start),
        clock=clock,
        speed=to_rad(90.0),
        acceleration=to_rad(100.0),
        scene=Scene(),
    )
