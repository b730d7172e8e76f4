"""Random sessions with the real module process, in real time.

The test plays viam-server and three clients; the module drives an arm on an emulated port, which
the referee watches, and a simulated one. Requests come at random, from all clients at once; some
are given up, clients go away, resources are configured anew, the port is pulled out, and the
process is stopped for up to two seconds and continued. Laws: every request ends, and not with an
error that nobody foresaw; Stop is answered soon, and nothing moves afterwards; the module writes
no traceback, grows no further, and ends when it is told to; the referee objects to nothing.
"""

import asyncio
import contextlib
import random
import signal
import tempfile
import time
from pathlib import Path

import numpy as np
from grpclib import GRPCError, Status
from grpclib.client import Channel
from grpclib.exceptions import StreamTerminatedError
from harness.fake_parent import (
    ARM,
    GRIPPER,
    HARDWARE_ARM,
    HARDWARE_GRIPPER,
    MOTION,
    SIMULATED,
    running_module,
)
from referee.official import Referee
from viam.components.arm import ArmClient, JointPositions, MoveOptions, Pose
from viam.components.gripper import GripperClient

from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.planning.kinematics.model import RobotModel

LONGEST = 40.0  # [s] that a request may take; a move, a plan, and a stop of the process
SOON = 3.0  # [s] in which Stop is answered, on a machine that is busy with other things, too
STILL = 1.5  # [deg] that a joint may be from where it was when Stop was answered
GROWTH = 150_000  # [kB] that the process may have more at the end than after a few requests
FORBIDDEN = (Status.UNKNOWN, Status.INTERNAL, Status.DATA_LOSS)
PAUSES = (0.0, 0.0, 0.0, 0.02, 0.1, 0.4)
STOPPED = (0.05, 0.5, 2.0)  # [s]

COMMANDS = (
    "ping", "controller_status", "diagnose", "verify_config", "test_servo_communication",
    "get_calibration", "reload_calibration", "health", "exit_manual_mode", "get_planning_setup",
    "get_surroundings",
    "servo_capabilities", "reinitialize", "get_motion_params", "get_position", "",
)  # fmt: skip


class Lateness:
    """How long this process, which is the servos as well, has waited for the processor [s]."""

    def __init__(self):
        self.seconds = 0.0
        self._task = asyncio.ensure_future(self._watch())

    async def _watch(self):
        while True:
            begin = time.monotonic()
            await asyncio.sleep(0.01)
            self.seconds += time.monotonic() - begin - 0.01

    def end(self):
        self._task.cancel()


class Session:
    """A module and those who use it, and which laws were broken."""

    def __init__(self, module, emulator, rng):
        self.module, self.emulator, self.rng = module, emulator, rng
        self.broken = []
        self._clients = [Channel(path=str(module.socket)) for _ in range(3)]
        self._tasks = set()

    async def open(self):
        port = self.emulator.port
        await self.module.add(ARM, HARDWARE_ARM, {"port": port}, "arm")
        await self.module.add(GRIPPER, HARDWARE_GRIPPER, {"port": port}, "gripper")
        await self.module.add(ARM, SIMULATED, {}, "sim")
        await self.module.add(MOTION, "devrel:so101:motion", {}, "planner")

    async def ask(self, requests):
        """So many requests at random, and then a Stop."""
        asks = [self._joints] * 4 + [self._pose, self._through] + [self._stop] * 2 + [
            self._look, self._look, self._command, self._command, self._jaw, self._manual,
            self._torque, self._reconfigure, self._client_goes, self._unplug,
        ]  # fmt: skip
        for _ in range(requests):
            ask = self.rng.choice(asks)
            self._begin(ask(), ask.__name__[1:])
            await asyncio.sleep(self.rng.choice(PAUSES))
        await self.judge_stop()
        await self._finish()

    async def stop_process(self, seconds):
        """Stop the process while the arm moves, and continue it."""
        arm = self._arm()
        goal = [self.rng.uniform(-60.0, 60.0), *(self.rng.uniform(-30.0, 30.0) for _ in range(4))]
        self._begin(arm.move_to_joint_positions(JointPositions(values=goal)), "move")
        await asyncio.sleep(self.rng.uniform(0.1, 0.8))
        self.module.process.send_signal(signal.SIGSTOP)
        await asyncio.sleep(seconds)
        self.module.process.send_signal(signal.SIGCONT)
        if seconds < 1.0:
            await asyncio.sleep(self.rng.uniform(0.0, 0.5))
        await self.judge_stop()
        await self._finish()

    # Requests

    def _arm(self):
        return ArmClient(self.rng.choice(("arm", "arm", "sim")), self.rng.choice(self._clients))

    def _gripper(self):
        return GripperClient("gripper", self.rng.choice(self._clients))

    def _goal(self):
        return JointPositions(values=[self.rng.uniform(-40.0, 40.0) for _ in range(5)])

    def _joints(self):
        return self._arm().move_to_joint_positions(self._goal())

    def _pose(self):
        place = {axis: self.rng.uniform(*ends) for axis, ends in
                 {"x": (150, 300), "y": (-150, 150), "z": (50, 250)}.items()}  # fmt: skip
        return self._arm().move_to_position(Pose(**place, o_z=self.rng.choice((-1, 0.3, 1))))

    def _through(self):
        options = MoveOptions(max_vel_degs_per_sec=self.rng.choice((5.0, 40.0, 1000.0)))
        goals = [self._goal() for _ in range(self.rng.randint(0, 4))]
        return self._arm().move_through_joint_positions(goals, options=options)

    def _stop(self):
        return self.rng.choice((self._arm(), self._gripper())).stop()

    def _look(self):
        arm = self._arm()
        return self.rng.choice(
            (arm.get_joint_positions, arm.get_end_position, arm.is_moving, arm.get_kinematics)
        )()

    def _command(self):
        values = (None, True, -1, 1e308, "é" * 500, [], {"a": {}}, 30)
        command = {"command": self.rng.choice(COMMANDS)}
        if self.rng.random() < 0.3:
            command[self.rng.choice(("value", "seconds", "p_gain", ""))] = self.rng.choice(values)
        return self.rng.choice((self._arm(), self._gripper())).do_command(command)

    def _jaw(self):
        gripper = self._gripper()
        percent = {"command": "set_position", "percentage": self.rng.uniform(-10, 110)}
        return self.rng.choice((gripper.open, gripper.grab, lambda: gripper.do_command(percent)))()

    def _manual(self):
        return self._arm().do_command({"command": "enter_manual_mode", "enabled_for": 2})

    def _torque(self):
        enable = self.rng.random() < 0.7
        return self._arm().do_command({"command": "set_torque", "enable": enable})

    async def _reconfigure(self):
        attributes = {"port": self.emulator.port}
        attributes["speed_degs_per_sec"] = self.rng.choice((20.0, 50.0, 90.0, 1e6))
        await self.module.remove(ARM, "arm")
        try:
            await self.module.add(ARM, HARDWARE_ARM, attributes, "arm")
        except GRPCError:
            attributes.pop("speed_degs_per_sec")
            await self.module.add(ARM, HARDWARE_ARM, attributes, "arm")

    async def _client_goes(self):
        place = self.rng.randrange(len(self._clients))
        gone, self._clients[place] = self._clients[place], Channel(path=str(self.module.socket))
        gone.close()

    async def _unplug(self):
        self.emulator.unplug()
        await asyncio.sleep(self.rng.choice((0.0, 0.1, 0.5)))
        self.emulator.plug()

    # How they end

    def _begin(self, call, what):
        task = asyncio.ensure_future(self._judged(call, what))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        if self.rng.random() < 0.2:
            asyncio.get_running_loop().call_later(self.rng.uniform(0.0, 0.5), task.cancel)

    async def _judged(self, call, what):
        try:
            async with asyncio.timeout(LONGEST):
                await call
        except GRPCError as error:
            if error.status in FORBIDDEN:
                self._object(f"{what}: {error.status.name}: {error.message}")
        except (StreamTerminatedError, ConnectionError, NotImplementedError):
            pass
        except TimeoutError:
            self._object(f"{what}: no answer within {LONGEST} s")

    async def judge_stop(self):
        """Stop is answered soon, and then nothing moves."""
        arms = [ArmClient(name, self._clients[0]) for name in ("arm", "sim")]
        for task in [*self._tasks]:
            task.cancel()  # what is asked for after a Stop may move
        await asyncio.sleep(0.0)
        for arm in arms:
            begin, late = time.monotonic(), Lateness()
            try:
                await arm.stop(timeout=LONGEST)
            except GRPCError as error:
                if error.status in FORBIDDEN:
                    self._object(f"stop: {error.status.name}: {error.message}")
                continue  # an arm that cannot be reached
            finally:
                late.end()
            took = time.monotonic() - begin
            if took - late.seconds > SOON:
                self._object(f"Stop of {arm.name} was answered after {took:.1f} s")
        limp = self._limp()
        before = self._q()
        await asyncio.sleep(0.4)
        moved = np.abs(self._q() - before)[:5]
        if not limp and not self._limp() and np.max(moved) > STILL:
            self._object(f"joints moved by {moved.round(1)} deg after a Stop")

    def _q(self):
        self.emulator.advance()
        return np.degrees(self.emulator.world.q)

    def _limp(self):
        return any(servo.drive.torque != 1 for servo in self.emulator.world.servos[:5])

    async def _finish(self):
        tasks = [*self._tasks]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if self.module.process.returncode is not None:
            self._object(f"the module ended by itself, {self.module.process.returncode}")
        for _, text in self.module.parent.lines:
            if "Traceback" in text:
                self._object(f"it wrote {text[-600:]}")
        self.module.parent.lines.clear()

    async def close(self):
        for client in self._clients:
            client.close()

    def memory(self):
        """What the process holds [kB]."""
        for line in Path(f"/proc/{self.module.process.pid}/status").read_text().splitlines():
            if line.startswith("VmRSS"):
                return int(line.split()[1])
        return 0

    def _object(self, what):
        self.broken.append(what)


async def _play(seed, sessions, requests):
    rng, referee = random.Random(seed), Referee()
    weight = RobotModel.load().gravity_torque
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        options = EmulatorOptions(link=Path(folder) / "arm")
        emulator = stack.enter_context(Emulator(options, gravity=weight))
        referee.attend(emulator)
        async with running_module() as (module, _, _):
            session = Session(module, emulator, rng)
            await session.open()
            await session.ask(requests)
            memory = session.memory()
            for k in range(1, sessions):
                if k % 2:
                    await session.stop_process(rng.choice(STOPPED))
                else:
                    await session.ask(requests)
            if session.memory() > memory + GROWTH:
                session.broken.append(f"it grew from {memory} to {session.memory()} kB")
            await session.close()
            module.process.send_signal(signal.SIGTERM)
            try:
                code = await module.ended()
                if code != 0:
                    session.broken.append(f"it ended with {code}")
            except TimeoutError:
                session.broken.append("it did not end within a minute")
                module.process.kill()
    return session.broken + [str(finding) for finding in referee.findings]


def run(seed, *, sessions, requests):
    """So many sessions, of which every second one stops the process; the laws that were broken."""
    return asyncio.run(_play(seed, sessions, requests))
