"""The real rig on emulated servos, with one clock for both that a test moves by hand; or on an arm.

A test that disturbs no servo runs on ``HardwareBench`` and on ``ArmBench`` alike, if it uses only
what ``ArmBench`` has.
"""

import asyncio
import math
import threading
from concurrent.futures import wait
from contextlib import closing

import numpy as np
from google.protobuf.struct_pb2 import Struct
from referee.command import STOP_JERK, CommandCaps
from referee.official import Caps, match_of
from viam.proto.app.robot import ComponentConfig

from harness.heard_port import opener_of
from harness.in_process_module import arm_client as arm_client
from harness.in_process_module import gripper_client as gripper_client
from so101_motion.common.attributes import LoadConfig
from so101_motion.common.clock import ManualClock
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.defaults import TIMEOUT
from so101_motion.drivers.emulator import registers as emu
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.port.serial_port import SerialPort
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.torque import Payload
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.viam.models.calibration import So101Calibration
from so101_motion.viam.models.hardware_arm import HardwareArm
from so101_motion.viam.models.hardware_gripper import HardwareGripper

PATIENCE = 0.1
"""Above what a busy machine mostly takes to run the emulator's thread [s]; every answer that does
get lost costs a test as much."""

STEP_DEG = 8.0
"""How far tests for either kind move a joint [deg]."""

MIDDLES_DEG = (4.1, -1.45, -5.8, -0.6, 3.2)
"""Where the emulated joints' travel has its middle, which a calibration takes for zero [deg]."""


def loaded(mass):
    """The arm with ``mass`` [kg] between its jaws."""
    model = RobotModel.load()
    payload = Payload.of(LoadConfig(mass=mass), model)
    return model if payload is None else model.with_payload(payload.mass, payload.com)


class PortBench:
    """The rigs on a port."""

    def __init__(self, port):
        self.port, self._rigs = port, []

    def settings(self, **changes):
        wanted = {"servo_ids": (1, 2, 3, 4, 5), "gripper_id": 6, **changes}
        return ServoSettings(**{"port": str(self.port), **wanted})

    def go(self, rig, *degrees):
        """Begin to move to joint angles; the motion, once it is under way."""
        goal = JointGoal(q=np.radians(np.array(degrees, dtype=float)))
        return rig.arm.move(rig.arm.plan(goal), wait=False)

    def shut(self, rig):
        self._rigs.remove(rig)
        rig.close()

    def close(self):
        for rig in self._rigs:
            rig.close()


class HardwareBench(PortBench):
    """Emulated servos on a port, and the rigs on it; one clock for all.

    Args:
        folder: For the port.
        reply_timeout: How long an answer is waited for, on the wall clock [s].
        held_kg: What the jaws hold, unknown to the rigs.
        name: Of the port.
        options: What else is emulated.
    """

    def __init__(
        self, folder, *, reply_timeout=PATIENCE, held_kg=0.0, clock=None, name="arm", **options
    ):
        self.clock, self.reply_timeout = clock or ManualClock(), reply_timeout
        super().__init__(folder / name)
        weight = loaded(held_kg).gravity_torque
        self.emulator = Emulator(
            EmulatorOptions(link=self.port, **options), now=self.clock.now, gravity=weight
        )
        self._match = match_of(self.emulator)
        self._match.ask_caps(self._caps)

    def _caps(self):
        speed = max((math.degrees(rig.arm.speed) for rig in self._rigs), default=50.0)
        return (Caps(speed),) * 5 + (Caps(90.0, 1376.0),)

    def _command_caps(self):
        arms = [rig.arm for rig in self._rigs]
        acceleration = math.degrees(max((arm.acceleration for arm in arms), default=10.0))
        jerk = STOP_JERK * math.degrees(200.0)
        arm = CommandCaps(self._caps()[0].speed, acceleration, jerk)
        return (arm,) * 5 + (CommandCaps(90.0, math.degrees(10.0), 3.0 * jerk, 1376.0),)

    def _record(self, rig):
        """Let the referee hear every command."""

        def ticks(i, q):
            found = rig.servos.setups.get((*ARM_JOINTS, GRIPPER_JOINT)[i])
            if found is None:
                return math.nan
            return found.map.zero_ticks + found.map.direction * q * 4096.0 / math.tau

        rig.servos.on_command = self._match.listen(self._command_caps, ticks, rig.executor.dt)
        rig.executor.requests.on_request = self._match.requested

    @property
    def world(self):
        return self.emulator.world

    @property
    def q_deg(self):
        """True angles of the six joints [deg]."""
        self.emulator.advance()
        return np.degrees(self.world.q)

    @property
    def driven(self):
        """Which servos have torque."""
        return [servo.memory.raw(emu.TORQUE_ENABLE) == 1 for servo in self.world.servos]

    def arm_deg(self, rig):
        """True angles of the arm joints as the rig counts them [deg]."""
        zeros = []
        for joint in ARM_JOINTS:
            servo = self.world.servo(joint)
            off = rig.servos.setups[joint].map.zero_ticks - servo.joint.zero_ticks
            zeros.append(servo.joint.direction * off * 360.0 / 4096.0)
        return self.q_deg[:5] - zeros

    def settings(self, **changes):
        return super().settings(**{"timeout": 0.01, **changes})

    def open(self, **changes):
        settings = self.settings(**changes)
        rig = open_hardware(
            settings,
            clock=self.clock,
            reply_timeout=self.reply_timeout,
            open_port=opener_of(self.emulator, settings.baudrate),
        )
        self._rigs.append(rig)
        self._record(rig)
        return rig

    def advance(self, seconds):
        self.clock.advance(seconds)

    @property
    def turn(self):
        """How long others get the processor between two advances [s]; while nothing moves,
        a plan may be being made, which takes real time."""
        is_moving = any(rig.arm.state.arm_moving or rig.gripper.is_moving for rig in self._rigs)
        return 0.001 if is_moving else 0.02

    def finish(self, motion, at_most=15.0):
        """Let time pass until ``motion`` is over; raises what it ended with."""
        future = getattr(motion, "future", motion)
        for _ in range(round(at_most / 0.05)):
            if future.done():
                break
            self.advance(0.05)
            wait([future], timeout=self.turn)
        return future.result(timeout=60.0)

    def under_way(self, motion, rig, seconds=0.3):
        """Let a motion get going."""
        for _ in range(10_000):
            if rig.arm.state.arm_moving or motion.future.done():
                break
            self.advance(0.0)
            wait([motion.future], timeout=0.002)  # its thread may have to wait for the processor
        self.advance(seconds)

    def close(self):
        super().close()
        self.emulator.close()


class ArmBench(PortBench):
    """An arm on a real port: time is real, motions are slow, and nobody can touch its servos."""

    @property
    def q_deg(self):
        """Where the six servos say they are, counted from their middle [deg]."""
        if self._rigs:
            rig = self._rigs[-1]
            state, to_ticks = rig.arm.state, rig.servos.to_ticks
            angles = dict(zip((*ARM_JOINTS, GRIPPER_JOINT), [*state.q, state.q_jaw], strict=True))
            ticks = [to_ticks(joint, q) for joint, q in angles.items()]
        else:
            bus = Bus(SerialPort(self.port))
            ticks = [bus.read(i, reg.PRESENT_POSITION) for i in range(1, 7)]
            bus.close()
        return (np.array(ticks) - 2048) * 360.0 / 4096.0

    def arm_deg(self, rig):
        """Angles of the arm joints as the rig measures them [deg]."""
        return np.degrees(rig.arm.state.q)

    def open(self, **changes):
        rig = open_hardware(self.settings(**changes))
        rig.arm.set_speed(rad(15.0))
        rig.arm.set_acceleration(rad(60.0))
        self._rigs.append(rig)
        return rig

    def advance(self, seconds):
        threading.Event().wait(seconds)

    def finish(self, motion, at_most=15.0):
        """Wait until ``motion`` is over; raises what it ended with."""
        return getattr(motion, "future", motion).result(timeout=4.0 * at_most)

    def under_way(self, motion, rig, seconds=0.3):
        while not (rig.arm.state.arm_moving or motion.future.done()):
            self.advance(0.005)
        self.advance(seconds)


def near(rig, *shares):
    """A posture near the present one: shares of ``STEP_DEG``, each joint towards its middle."""
    q = np.degrees(rig.arm.state.q)
    return q - np.where(q > 0.0, 1.0, -1.0) * STEP_DEG * np.array(shares)


def hardware_bench(folder, **options):
    return closing(HardwareBench(folder, **options))


def rad(degrees):
    return math.radians(degrees)


class ModelBench(HardwareBench):
    """The same, with components on it that are talked to as viam-server does."""

    def __init__(self, folder, **options):
        super().__init__(folder, **options)
        self._built = []
        # Whoever comes first decides the clock; this share asks for no servo at all.
        self.base = self.open(servo_ids=None, gripper_id=None, timeout=TIMEOUT)

    def build(self, model, name, attributes):
        """Build a component, which has to be closed before the end, and do not wait for it."""
        struct = Struct()
        struct.update(attributes)
        config = ComponentConfig(
            name=name, api=str(model.API), model=str(model.MODEL), attributes=struct
        )
        return model.new(config, {})

    def new(self, model, name, **attributes):
        component = self.build(model, name, attributes)
        if isinstance(component, (HardwareArm, HardwareGripper)):
            component.rig.first_try.result(timeout=60.0)  # requests wait for it themselves
        self._built.append(component)
        return component

    def new_arm(self, name="arm", **attributes):
        return self.new(HardwareArm, name, **{"port": str(self.port), **attributes})

    def new_gripper(self, name="gripper", **attributes):
        return self.new(HardwareGripper, name, **{"port": str(self.port), **attributes})

    def new_sensor(self, **attributes):
        return self.new(So101Calibration, "calibration", port=str(self.port), **attributes)

    async def pass_time(self, seconds):
        await asyncio.to_thread(self.advance, seconds)

    async def in_time(self, call, step=0.05, at_most=60.0):
        """The outcome of ``call`` while time passes."""
        task = asyncio.ensure_future(call)
        for _ in range(round(at_most / step)):
            if task.done():
                break
            await self.pass_time(step)
            await asyncio.wait([task], timeout=self.turn)
        assert task.done(), "it never ended"
        return await task

    async def start(self, call, is_under_way):
        """``call`` as a task, once it is seen to have an effect."""
        task = asyncio.ensure_future(call)
        for _ in range(2000):
            if task.done() or is_under_way():
                return task
            await self.pass_time(0.02)
            await asyncio.wait([task], timeout=self.turn)
        raise AssertionError("it never began")

    async def until_it_rests(self, client, at_most=10.0):
        """Let time pass until a component says that nothing is under way any more."""
        for _ in range(round(at_most / 0.02)):
            if not await client.is_moving():
                return
            await self.pass_time(0.02)
        raise AssertionError("it never came to rest")

    async def end(self):
        for component in self._built:
            await self.in_time(component.close())
        await self.in_time(asyncio.to_thread(self.close))
