"""A Viam machine with our module, to connect clients to.

The module's real process runs, with a stand-in for viam-server as its parent. Its own socket speaks
the robot protocol as well as the module's, so a port of 127.0.0.1 that forwards to it is a machine:
plain, without a key. The port can be closed and opened again, as when a cable is pulled.

    with running_machine() as machine:                 # a simulated arm and gripper
        MachineRig.connect(machine.address)

    with running_machine(emulated=True) as machine:    # on six emulated servos, with all our models
"""

import asyncio
import contextlib
import functools
import sys
import tempfile
import threading
import time
from concurrent.futures import Future
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path

import viam.services.discovery  # noqa: F401  # importing registers the client

from harness.emulated_port import emulated_port, works
from harness.fake_machine import FakeMachine
from harness.fake_parent import (
    ARM,
    CALIBRATION,
    DISCOVERY,
    GRIPPER,
    HARDWARE_ARM,
    HARDWARE_GRIPPER,
    MODULE,
    SENSOR,
    SIMULATED,
    SIMULATED_GRIPPER,
    running_module,
    until,
)
from harness.terminal_user import PATIENT

SIM = ((ARM, SIMULATED, "arm", {}), (GRIPPER, SIMULATED_GRIPPER, "gripper", {}))
"""What the machine has by default: api, model, name, attributes."""


def on_port(port):
    """What a machine with an arm on ``port`` has."""
    return (
        (ARM, HARDWARE_ARM, "arm", {"port": port}),
        (GRIPPER, HARDWARE_GRIPPER, "gripper", {"port": port}),
        (SENSOR, CALIBRATION, "calibration", {"port": port}),
        ("rdk:service:discovery", DISCOVERY, "discovery", {}),
    )


def pause():
    """Give the other threads the processor; what they wait for is a process elsewhere."""
    threading.Event().wait(0.01)


def until_true(condition, patience=60.0):
    """Wait for what happens in a process elsewhere, whose time is real."""
    begin = time.monotonic()
    while not condition():
        assert time.monotonic() - begin < patience, "it does not happen"
        pause()


class Door:
    """A TCP port of 127.0.0.1 that leads to a socket."""

    def __init__(self, socket):
        self.port = 0
        self._socket = socket
        self._server = None
        self._pipes = set()

    async def open(self):
        self._server = await asyncio.start_server(self._enter, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def shut(self):
        if self._server is not None:
            self._server.close()
            self._server = None
        pipes = set(self._pipes)
        for pipe in pipes:
            pipe.cancel()
        await asyncio.gather(*pipes, return_exceptions=True)

    async def _enter(self, reader, writer):
        self._pipes.add(asyncio.current_task())
        try:
            inner_reader, inner_writer = await asyncio.open_unix_connection(self._socket)
            try:
                await asyncio.gather(_forward(reader, inner_writer), _forward(inner_reader, writer))
            finally:
                inner_writer.transport.abort()
        except (asyncio.CancelledError, OSError):
            pass
        finally:
            writer.transport.abort()
            self._pipes.discard(asyncio.current_task())


async def _forward(reader, writer):
    while chunk := await reader.read(65536):
        writer.write(chunk)
        await writer.drain()
    with contextlib.suppress(OSError, RuntimeError):
        writer.write_eof()


class Machine:
    """A running machine. Its methods may be called from any thread.

    Attributes:
        address: For ``MachineRig.connect`` and ``--machine``.
        port: The serial port of its emulated arm; None for a simulated one.
    """

    def __init__(self, loop, module, door, servos):
        self._loop, self._module, self._door, self._servos = loop, module, door, servos
        self.address = f"127.0.0.1:{door.port}"
        self.port = None if servos is None else servos.port

    def cut(self):
        """Pull the network cable: connections break and nobody gets in."""
        self._run(self._door.shut())

    def mend(self):
        """Plug it in again, at the same address."""
        self._run(self._door.open())

    def fault(self, line):
        """Let something happen to the emulated servos, e.g. ``unplug`` or ``end unplug``."""
        self._run(self._servos.fault(line))

    def has_around(self, *frames):
        """Set its frame system, of ``hanging`` components."""
        self._module.parent.machine = FakeMachine(*frames)

    def has_nothing_around(self):
        self._module.parent.machine = None

    def remove(self, api, name):
        self._run(self._module.remove(api, name))

    def add(self, api, model, name, attributes=None):
        """Put a resource into the machine's configuration."""
        return self._run(self._module.add(api, model, attributes or {}, name))

    def _run(self, work):
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(60.0)


@contextmanager
def running_machine(*, emulated=False, resources=None, is_patient=False):
    """Start a machine; it ends with the block.

    Args:
        emulated: Whether its arm is on emulated servos, which somebody holds up until it holds
            itself, instead of simulated.
        is_patient: Whether it waits for each servo of the tests until a busy machine lets that
            answer; long where servos are missing.
        resources: What it has, like ``SIM``; by default an arm, a gripper, and on emulated servos
            the calibration and discovery as well.
    """
    loop, ready, done = asyncio.new_event_loop(), Future(), asyncio.Event()

    async def live():
        try:
            async with AsyncExitStack() as stack:
                ready.set_result(await _start(stack, loop, emulated, resources, is_patient))
                await done.wait()
        except BaseException as error:
            if ready.done():
                raise
            ready.set_exception(error)

    thread = threading.Thread(target=lambda: loop.run_until_complete(live()), name="machine")
    thread.start()
    try:
        yield ready.result()
    finally:
        loop.call_soon_threadsafe(done.set)
        thread.join()
        loop.close()


async def _start(stack, loop, emulated, resources, is_patient):
    servos = None
    if emulated:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="so101-"))
        servos = await stack.enter_async_context(emulated_port(Path(folder)))
    command = (sys.executable, "-c", PATIENT + MODULE if is_patient else MODULE)
    module, _, _ = await stack.enter_async_context(running_module(command=command))
    for api, model, name, attributes in resources or (on_port(servos.port) if servos else SIM):
        component = await module.add(api, model, attributes, name)
        if servos is not None and api == ARM:
            await until(functools.partial(works, component.get_geometries))
    if servos is not None:
        await servos.let_go()
    door = Door(module.socket)
    await door.open()
    stack.push_async_callback(door.shut)
    return Machine(loop, module, door, servos)
