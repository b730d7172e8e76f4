"""The arm and gripper of a running machine, with the interface of a rig (``RigLike``).

Goals are planned on this computer, by the same planner as for a local arm, from the joint angles
that the machine reports and around ``arm.scene`` and what the machine has around the arm besides,
which is read once a second, as its caps are. The arm's scene, calibrated ranges and highest caps
are read when the connection is first made. Setting the caps here sets them on the machine; setting
the scene here changes it only here.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from grpclib import GRPCError
from viam.components.arm import Arm as ViamArm
from viam.components.gripper import Gripper
from viam.robot.client import RobotClient

from so101_motion.arm.arm import Arm
from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN, JawVerbs
from so101_motion.arm.joint_caps import JointCaps
from so101_motion.arm.motion_handle import Motion
from so101_motion.arm.planning_worker import acquire_worker, release_worker
from so101_motion.common import interrupts
from so101_motion.common.attributes import checked_number, suggest
from so101_motion.common.errors import (
    ArmClosed,
    ChoiceNeeded,
    ConfigError,
    MachineRefused,
    MotionError,
    So101Error,
)
from so101_motion.common.modes import Mode
from so101_motion.common.operation import Operation, RemoteOperation
from so101_motion.common.state import JointState
from so101_motion.common.units import to_rad
from so101_motion.files.scene_file import arms_from, attached_from, obstacles_from, scene_from
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import Goal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.request import Search
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.session_end import AtEnd, leave_as_asked
from so101_motion.viam.client.executor import STOPPING, MachineExecutor, MotionRunner
from so101_motion.viam.client.link import LOSSES, PATIENCE, Access
from so101_motion.viam.client.machine import Machine, is_there
from so101_motion.viam.client.reports import GripperReport, ask_arm, ask_gripper, next_state
from so101_motion.viam.conversion.world_state import UniqueNames, taken_in
from so101_motion.viam.requests.commands import in_deg

_LOOK = 0.05
"""How often to ask whether the jaw has arrived, if its command did not wait [s]; chosen."""


class MachineGripper(JawVerbs, MotionRunner):
    """Opens and closes the jaw. A new motion takes over from the one under way."""

    def __repr__(self) -> str:
        return f"<MachineGripper {self._rig.jaw.aperture:.0%} open>"

    @property
    def aperture(self) -> float:
        """How far it is open: 0 closed, 1 open."""
        return self._rig.live_jaw.aperture

    @property
    def q_jaw(self) -> float:
        """Measured jaw angle [rad], taken from the aperture over the jaw's full travel."""
        return self.angle_of(self.aperture)

    @property
    def is_moving(self) -> bool:
        return self._rig.jaw.is_moving

    @property
    def is_holding(self) -> bool:
        """Whether it holds something, as far as it reports that."""
        return self._rig.live_jaw.is_holding

    def angle_of(self, aperture: float) -> float:
        """The jaw angle [rad] that an aperture stands for, over the jaw's full travel."""
        return JAW_CLOSED + aperture * (JAW_OPEN - JAW_CLOSED)

    def move(self, aperture: float, *, wait: bool = True) -> Motion:
        """Open or close to ``aperture``, 0 to 1."""
        checked_number("aperture", aperture, lower=0.0, upper=1.0)
        return self._send({"command": "set_position", "percentage": 100.0 * aperture}, wait)

    def grab(self, aperture: float = 0.0, *, wait: bool = True) -> Motion:
        """Close until something is gripped or the jaw is closed; ``is_holding`` tells which.

        ``aperture`` is ignored, because the machine decides itself what counts as closed.
        """
        return self._send(None, wait)

    def stop(self) -> None:
        self.bring_to_rest("stop").result()

    def _send(self, command: Mapping[str, Any] | None, wait: bool) -> Motion:
        """Send ``command``, or a grab; the motion ends when the jaw rests."""

        async def move() -> None:
            gripper = self._rig.find_gripper()
            with self._link.asking("moving the jaw"):
                if command is None:
                    await gripper.grab()
                else:
                    await gripper.do_command(command)
                while True:  # the command need not wait for the jaw to rest
                    if not await gripper.is_moving():
                        return
                    await asyncio.sleep(_LOOK)

        motion = Motion()
        running = self.begin(move)
        motion.halt = partial(self.interrupt, running)
        running.add_done_callback(motion.take_outcome)
        if wait:
            motion.result()
        return motion

    async def _brake(self) -> None:
        try:
            gripper = self._rig.find_gripper()
        except ConfigError:
            return  # there is none, or none was chosen of several
        with self._link.asking("stop"):
            await gripper.stop(timeout=STOPPING)


class MachineArm(Arm):
    """The arm of a machine. ``set_speed`` and ``set_acceleration`` set the machine's as well."""

    tell: Callable[[Mapping[str, Any]], object] | None = None
    """Sends a request to the machine's arm; None if that arm has no such caps."""

    surroundings: Callable[[], Mapping[str, Any]] = staticmethod(dict)
    """What the machine has around the arm besides ``scene``, as it said last: ``obstacles`` and
    ``attached`` as in a scene file, its other ``arms``, or why that is not known (``unknown``)."""

    def take_caps(self, told: Mapping[str, Any], before: tuple[float, float]) -> None:
        """Take over the caps that the machine told, unless those here were others ``before``."""
        mine = self.speed, self.acceleration
        known = dict(zip(_CAPS, map(in_deg, mine), strict=True))
        new = {**known, **told}
        if mine == before and new != known:
            speed, acceleration = (to_rad(float(new[key])) for key in _CAPS)
            self._caps = JointCaps(speed=speed, acceleration=acceleration)

    def set_speed(self, speed: float) -> None:
        before = self._caps
        super().set_speed(speed)
        self._pass_on({"set_speed": in_deg(speed)}, before)

    def set_acceleration(self, acceleration: float) -> None:
        before = self._caps
        super().set_acceleration(acceleration)
        self._pass_on({"set_acceleration": in_deg(acceleration)}, before)

    def start_replanned(
        self, goal: Goal, search: Callable[[Scene], Search], *, limits: MotionLimits | None = None
    ) -> Motion:
        raise MotionError(
            "a motion is planned again only where the arm is; send its machine"
            ' MoveToPosition with {"replan": true} in extra'
        )

    def _with_surroundings(self, scene: Scene) -> Scene:
        told = self.surroundings()
        if "unknown" in told:
            raise MachineRefused("planning", "UNAVAILABLE", str(told["unknown"]))
        names = UniqueNames(taken_in(scene))
        things = obstacles_from(told.get("obstacles", []), folder=None)
        obstacles = [replace(each, name=names.new(each.name)) for each in things]
        held = attached_from(told.get("attached", []), folder=None)
        attached = [replace(each, name=names.new(each.name)) for each in held]
        return replace(
            scene,
            arms=(*scene.arms, *arms_from(told.get("arms", []))),
            obstacles=(*scene.obstacles, *obstacles),
            attached=(*scene.attached, *attached),
        )

    def _pass_on(self, request: Mapping[str, Any], before: JointCaps) -> None:
        """Tell the machine; if it refuses, nothing changes."""
        if self.tell is not None:
            try:
                self.tell(request)
            except So101Error:
                self._caps = before
                raise


BUSY, IDLE = 1.0 / 30.0, 0.1
"""Time between two readings of the machine's state, while something moves and at rest [s]. Chosen:
fast enough for the eye, and nearly free."""

_log = logging.getLogger(__name__)

_LOOKED_AROUND = 1.0
"""Time between two readings of what the machine has around the arm [s]; chosen, as its guard."""

_VIEWED = 0.3  # time between two readings of an operation's view [s]; chosen

_SILENT = "the obstacles around the arm are not known: the machine did not answer in time"

_RANGE_KEYS = ("joint_min_deg", "joint_max_deg")
_CAPS = ("current_speed_degs_per_sec", "current_acceleration_degs_per_sec_per_sec")
_MOST = ("max_speed_degs_per_sec", "max_acceleration_degs_per_sec_per_sec")


class MachineRig(Machine):
    """An arm and gripper of a running machine. ``connect`` makes it; close it after use.

    Attributes:
        arm_name: The name of the machine's arm, for ``do_command``.
        at_end: As of a ``Rig``, like ``on_left``; a machine parks its arm itself.
        status: The arm's newest status, such as ``health`` and ``notes`` of its servos.
    """

    _shown = (
        "arm arm_name at_end clock close connect connection do_command gripper has_gripper refresh "
        "resources start_request state status"
    )
    at_end = AtEnd()
    on_left: Callable[[str], None] = staticmethod(_log.warning)

    def __init__(self, access: Access, *, arm: str | None, gripper: str | None) -> None:
        super().__init__(access)
        self._wanted = {"arm": arm, "gripper": gripper}
        self._arm: ViamArm | None = None
        self._gripper: Gripper | None = None
        self._state: JointState | None = None
        self.status: Mapping[str, Any] = {}
        self.jaw = GripperReport()
        self.arm_name = ""
        self._no_gripper = "the machine has none"
        self._params: Mapping[str, Any] = {}
        self._setup: Mapping[str, Any] = {}
        self._around: Mapping[str, Any] = {}
        self._looked, self._made = threading.Event(), asyncio.Event()
        self._closed = False
        self.link.open()
        worker = acquire_worker()
        try:
            self._executor, self.gripper = MachineExecutor(self), MachineGripper(self)
            caps = zip(_CAPS, (50.0, 100.0), strict=True)
            speed, acceleration = (self._params.get(key, default) for key, default in caps)
            self.arm = self._new_arm(
                to_rad(speed), to_rad(acceleration), partial(worker.plan, owner=self)
            )
            self.link.post(self._made.set)
            worker.start()
        except BaseException:
            release_worker()
            self.link.close()
            raise

    @classmethod
    def connect(
        cls,
        address: str,
        *,
        api_key_id: str | None = None,
        api_key: str | None = None,
        arm: str | None = None,
        gripper: str | None = None,
    ) -> MachineRig:
        """Connect as ``Machine.connect`` does; nothing moves.

        ``arm`` and ``gripper`` name one of several. ``ConfigError`` if the machine has none of that
        name, or several arms and none was named; without a gripper only the arm is moved.
        """
        access = Access(address=address, api_key_id=api_key_id, api_key=api_key)
        return cls(access, arm=arm, gripper=gripper)

    def _new_arm(self, speed: float, acceleration: float, planner: Any) -> MachineArm:
        arm = MachineArm(
            model=RobotModel.load(),
            executor=self._executor,
            planner=planner,
            clock=self.clock,
            speed=speed,
            acceleration=acceleration,
            scene=scene_from(self._setup["scene"], folder=None) if self._setup else Scene(),
        )
        if self._setup:
            lower, upper = (to_rad(np.array(self._setup[key])) for key in _RANGE_KEYS)
            arm.set_range(lower, upper)
        if _MOST[0] in self._setup:
            speed, acceleration = (to_rad(self._setup[key]) for key in _MOST)
            arm.set_ceiling(JointCaps(speed=speed, acceleration=acceleration))
        if self._params:
            arm.tell = lambda command: self.do_command(self.arm_name, command)
        arm.surroundings = self._surroundings
        return arm

    def _surroundings(self) -> Mapping[str, Any]:
        if not self._looked.wait(4.0 * PATIENCE):  # for the first answer after connecting
            return {"unknown": _SILENT}
        return self._around

    # State

    def __repr__(self) -> str:
        now = "closed" if self._closed else self.state.mode.value
        return f"<MachineRig: {self.connection.to}, {now}>"

    @property
    def state(self) -> JointState:
        """The newest snapshot; never waits."""
        assert self._state is not None  # the link opened with it
        return self._state

    @property
    def live_jaw(self) -> GripperReport:
        """What was last heard of the jaw; ``ArmClosed`` after ``close``."""
        if self._closed:
            raise ArmClosed
        return self.jaw

    @property
    def has_gripper(self) -> bool:
        return self._gripper is not None

    def refresh(self) -> JointState:
        """Read the machine's state now."""
        self.link.run(self.look()).result()
        return self.state

    def start_request(self, command: Mapping[str, Any]) -> Motion:
        """Send the arm a DoCommand that moves it, such as ``replay_path``.

        It is a motion like any other: it supersedes what is under way, may take as long as it
        needs, and a stop, a newer motion or ``Motion.interrupt`` ends it.
        """

        def run(motion: Motion) -> None:
            with motion.begin():
                running = self._executor.request(command)
                motion.halt = partial(self._executor.interrupt, running)
            running.result()

        return self.arm.start_series([run])

    def operation(self, name: str, moves: Collection[str]) -> Operation:
        """An operation of the machine's arm.

        A command in ``moves`` is a motion that a stop here ends; its answer is empty.

        Raises:
            MachineRefused: It is not an arm of this module, or has no such operation.
            MachineUnavailable: It does not answer.
        """

        def send(request: Mapping[str, Any]) -> Mapping[str, Any]:
            if request.get("ask") in moves:
                self.start_request(request).result()
                return {"answer": "{}"}
            return self.do_command(self.arm_name, request)

        return RemoteOperation(send, name, period=_VIEWED)

    @interrupts.held()
    def close(self) -> None:
        """End our motion, do as ``at_end`` says, and disconnect. May be called twice."""
        if self._closed:
            return
        leave_as_asked(self)
        self._closed = True
        self.arm.close()
        self._executor.end()
        self.gripper.end()
        super().close()
        release_worker()

    # The loop's thread

    async def _poll(self, client: RobotClient, connected: Callable[[], None]) -> None:
        arm = self._pick(client, "arm")
        if arm is None:
            raise ConfigError("arm", None, "the machine has none; add one to its configuration")
        self._arm, self._gripper = arm, self._pick(client, "gripper")
        self.arm_name = arm.name
        if self._state is None:
            self._params = await _answer(arm, {"get_motion_params": True})
            self._setup = await _answer(arm, {"command": "get_planning_setup"})
        looking = asyncio.ensure_future(self._look_around(arm))
        try:
            while True:
                begin = self.clock.now()
                try:
                    await self._ask_both()
                except GRPCError as error:
                    refusal = f"cannot report its state: {error.message}"
                    if self._state is None:
                        raise MachineRefused(arm.name, error.status.name, refusal) from error
                    await is_there(client)
                    self._fault(f'the arm "{arm.name}" of the machine {refusal}')
                connected()
                moves = self.state.arm_moving or self.state.jaw_moving
                await asyncio.sleep(begin + (BUSY if moves else IDLE) - self.clock.now())
        finally:
            looking.cancel()

    async def _look_around(self, arm: ViamArm) -> None:
        """Read what is around the arm again and again, so that nobody waits for it but a plan.

        And its caps, which other clients set as well, and which a module that starts again forgets.
        """
        command = {"command": "get_surroundings"}
        await self._made.wait()
        while self._setup:  # else it is no arm of our module
            try:
                self._around = await arm.do_command(command, timeout=3.0 * PATIENCE)
                before = self.arm.speed, self.arm.acceleration
                self.arm.take_caps(await _answer(arm, {"get_motion_params": True}), before)
            except GRPCError as error:
                self._around = {"unknown": error.message or _SILENT}
            except LOSSES:
                self._around = {"unknown": _SILENT}
            self._looked.set()
            await asyncio.sleep(_LOOKED_AROUND)
        self._looked.set()

    async def _ask_both(self) -> None:
        arm, gripper = self._arm, self._gripper
        assert arm is not None  # ``_poll`` has found it
        begin = self.clock.now()
        async with asyncio.timeout(PATIENCE):
            answered, self.jaw = await asyncio.gather(ask_arm(arm), ask_gripper(gripper, self.jaw))
        t = 0.5 * (begin + self.clock.now())
        if self._state is None or t > self._state.t:
            self.status = answered.status
            self._state = next_state(self._state, answered, self.jaw, t)

    async def look(self) -> None:
        self.link.client()
        with self.link.asking("its state"):
            await self._ask_both()

    def _on_loss(self, problem: str) -> None:
        self._arm = self._gripper = None
        self._fault(f"the connection to the machine is lost: {problem}")

    def _fault(self, sentence: str) -> None:
        if self._state is not None:
            self._state = replace(
                self._state,
                t=self.clock.now(),
                mode=Mode.FAULT,
                fault=sentence,
                arm_moving=False,
                jaw_moving=False,
            )

    def find_arm(self) -> ViamArm:
        self.link.client()
        assert self._arm is not None  # it is there as long as the client is
        return self._arm

    def find_gripper(self) -> Gripper:
        self.link.client()
        if self._gripper is None:
            raise ConfigError("gripper", self._wanted["gripper"], self._no_gripper)
        return self._gripper

    def _pick(self, client: RobotClient, what: str) -> Any:
        """The named arm or gripper, or the only one; None if there is none."""
        there = {each.name: each for each in client.resource_names if each.subtype == what}
        wanted = self._wanted[what]
        if wanted is not None and wanted not in there:
            # one without any may still be starting
            refused = ChoiceNeeded if there else ConfigError
            raise refused(what, wanted, f"is not on the machine; {suggest(wanted, sorted(there))}")
        if wanted is None and len(there) > 1:
            several = f"the machine has several; name one of {', '.join(sorted(there))}"
            several += f' (--{what} NAME; in Python MachineRig.connect("HOST:PORT", {what}="NAME"))'
            if what == "arm":
                raise ChoiceNeeded(what, None, several)
            self._no_gripper = several  # raised when the jaw is to move
            return None
        chosen = wanted or next(iter(there), None)
        return None if chosen is None else client.get_component(there[chosen])


async def _answer(arm: ViamArm, command: Mapping[str, Any]) -> Mapping[str, Any]:
    """Send a DoCommand to the arm; an empty answer if it does not know the command."""
    try:
        return await arm.do_command(command, timeout=PATIENCE)
    except GRPCError:
        return {}
