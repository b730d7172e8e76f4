"""``devrel:so101:arm``: the real arm on a serial port."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from viam.components.arm import JointPositions
from viam.resource.types import Model

from so101_motion.common.attributes import Attributes
from so101_motion.common.errors import So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import range_deg, to_deg
from so101_motion.control.limit_recovery import FARTHEST_OUT, remarks
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.hardware_rig import HardwareRig, open_without_waiting
from so101_motion.setup.identify_operation import IdentifyOperation
from so101_motion.viam.component_config import HardwareArmConfig
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.conversion.kinematics import chain
from so101_motion.viam.models.arm_resource import AT_START, ArmResource, scene_of
from so101_motion.viam.models.configured import Dependencies
from so101_motion.viam.requests.servo_commands import (
    ServoCommands,
    health,
    out_of_fault,
    out_of_range,
    ready,
    require_connected,
)


class HardwareArm(ArmResource):
    """The SO-101 arm.

    The component starts without its servos and looks for them in the background. Until they answer,
    requests that need them are refused with UNAVAILABLE, and the status names the silent servos.

    A fault (an unplugged cable, a servo that restarted) ends the motion under way. The next request
    to move makes the arm hold its position, if the servos answer, and moves it.
    """

    MODEL: ClassVar = Model.from_string("devrel:so101:arm")
    CONFIG = HardwareArmConfig
    NEEDS_SERVOS = frozenset(
        {
            "enter_manual_mode", "exit_manual_mode", "get_calibration", "get_planning_setup",
            "get_surroundings", "identify", "operation", "ping", "record_path", "replay_path",
            "run_program", "servo_capabilities",
            "servo_move", "servo_moving", "servo_position", "servo_stop", "servo_wait_stop",
            "set_torque", "set_torque_limit",
        }
    )  # fmt: skip

    rig: HardwareRig

    def __init__(
        self, name: str, rig: HardwareRig, config: HardwareArmConfig, dependencies: Dependencies
    ) -> None:
        super().__init__(name, rig, config, dependencies)
        self._remarked: set[str] = set()
        self._servo_ids = servo_ids = config.servo_ids
        identification = IdentifyOperation(
            rig, self._clear, partial(self.logger.info, "identification: %s")
        )
        self._commands |= {
            **ServoCommands(rig, servo_ids, self._manual, self.logger).commands,
            **self._asked("identification", identification, ("identify",)),
        }

    @classmethod
    def build(cls, name: str, wanted: HardwareArmConfig, dependencies: Dependencies) -> HardwareArm:
        scene = scene_of(wanted)
        asked = replace(
            wanted.connection.servo_settings(),
            at_end=wanted.at_end,
            joint_zero=wanted.joint_zero,
        )
        rig = open_without_waiting(asked.with_arm(wanted.servo_ids, wanted.zero_offsets))
        try:
            rig.arm.set_speed(wanted.speed)
            rig.arm.set_acceleration(wanted.acceleration)
            rig.arm.compliance = wanted.compliance
            rig.arm.scene = scene
            rig.warm_up()
            return cls(name, rig, wanted, dependencies)
        except BaseException:
            rig.close()
            raise

    async def get_joint_positions(self, **kwargs: Any) -> JointPositions:
        await self.measured()
        q = self._arm.state.q
        remarked = {remark.partition(" ")[0]: remark for remark in served_remarks(q)}  # by joint
        for joint, remark in remarked.items():
            if joint not in self._remarked:
                self.logger.warning("%s", remark)
        self._remarked = set(remarked)
        return convert.to_joint_positions(served_joints(q))

    def _clear(self) -> Scene:
        """Make the arm ready to move, and return what is around it; for a thread."""

        async def scene() -> Scene:
            await out_of_fault(self.rig)
            own, around = self._arm.scene, self.surroundings
            return await around.around(own) if around.is_asked() else own

        return asyncio.run_coroutine_threadsafe(scene(), self._loop).result()

    def _is_here(self, q: Array) -> bool:
        """Whether ``q`` is where the arm is, as measured or as reported to viam-server."""
        reported = served_joints(self._arm.state.q)
        return super()._is_here(q) or bool(np.max(np.abs(q - reported)) <= AT_START)

    async def found(self) -> None:
        with grpc_statuses():
            await ready(self.rig)

    async def measured(self) -> None:
        await self.found()
        with grpc_statuses():
            require_connected(self.rig)

    async def ready(self) -> None:
        """Hold again after a fault and read the other arms' positions, before a move."""
        with grpc_statuses():
            await out_of_fault(self.rig)
        await super().ready()

    # Requests

    async def _enter_manual_mode(self, given: Attributes) -> dict[str, Any]:
        return {**await super()._enter_manual_mode(given), "servos": list(self._servo_ids)}

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        status = dict(await super().get_status(**kwargs))
        rig, servos, state = self.rig, self.rig.servos, self._arm.state
        missing = [f"not ready: {rig.not_ready}"] if rig.not_ready else []
        served = [] if missing else served_remarks(state.q)
        status |= {
            "not_ready": rig.not_ready,
            "connected": servos.is_connected,
            "port_losses": servos.port_losses,
            "alarms": dict(state.reading.alarms),
            "notes": [*missing, *servos.notes, *remarks(state.reading), *served],
            "out_of_range": out_of_range(state.reading),
            "uncalibrated": list(rig.uncalibrated),
            "lent_to": state.lent_to,
            "health": health(servos),
        }
        return convert.to_result(status)

    async def close(self) -> None:
        self._manual.forget()
        if self.here.get(self.short_name) is self:
            try:
                await self._at_rest(self._arm.start_stop())
            except So101Error as error:
                self.logger.warning("the arm could not be stopped properly: %s", error)
        await super().close()


def served_limits() -> tuple[Array, Array]:
    """The joint limits that viam-server knows, lower and upper, shapes (5,), [rad]."""
    joints = [segment for segment in chain() if segment.joint is not None]
    return np.array([each.lower for each in joints]), np.array([each.upper for each in joints])


def served_joints(q: Array) -> Array:
    """The angles to report to viam-server for an arm at ``q``, both shape (5,), [rad].

    viam-server checks every arm of a machine against the served limits before it plans: with one
    joint a tick outside, its builtin motion service moves no arm at all. Real joints do rest
    outside, because a joint's zero is known to a few degrees only. So an angle is moved inside, by
    ``FARTHEST_OUT`` at most (a joint farther out is most likely not calibrated), and the status has
    a note. Pose, geometries, status and our own plans use the measured angles.
    """
    inside = np.clip(q, *served_limits())
    return np.where(np.abs(q - inside) <= FARTHEST_OUT, inside, q)


def served_remarks(q: Array) -> list[str]:
    lower, upper = served_limits()
    found = []
    for i in np.flatnonzero((q < lower) | (q > upper)):
        here, between = to_deg(float(q[i])), range_deg(float(lower[i]), float(upper[i]), 1)
        said = to_deg(float(served_joints(q)[i]))
        then = (
            f"GetJointPositions says {said:.1f} deg, because viam-server's builtin motion service"
            " moves no arm of the machine while one is outside; joint_positions_deg of the status"
            " is what was measured. Move the joint inside, or calibrate the arm again"
            if said != here
            else "viam-server's builtin motion service moves no arm of the machine until it is"
            " inside. Move it inside by hand, or calibrate the arm again"
        )
        found.append(
            f"{ARM_JOINTS[i]} is at {here:.1f} deg, outside the limits that viam-server knows,"
            f" {between} deg; {then}"
        )
    return found
