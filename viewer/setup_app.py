"""Serve the setup on a page of its own: ``so101 setup --web``. No arm is needed yet."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from so101_motion.calib.motors.progress import NAME, SetupProgress
from so101_motion.setup.port_selection import REPLY_TIMEOUT, own_folder
from so101_motion.viam.client import Machine

from .app import serve
from .scene.camera_and_lights import Sight, set_up_view
from .server.guarded_server import GuardedServer, start_guarded
from .server.host import ServedPage
from .server.kept_key import KeyOf, new_key
from .setup.part import SetupPart
from .setup.setup_bar import SetupBar
from .setup.setup_target import ArmSource, known_arm
from .setup.setup_target import ports as ports_of

_SIGHT = Sight(middle=np.array([0.1, 0.0, 0.17]))
"""Higher than for other pages, so that an arm stretched upwards is in the picture."""


class SetupApp(ServedPage):
    """A served setup; closing it undoes a running calibration."""

    def __init__(
        self,
        server: GuardedServer,
        *,
        source: ArmSource,
        progress: SetupProgress,
    ) -> None:
        super().__init__(server)
        context = self.host.page_context()
        set_up_view(context.server, _SIGHT)
        part = SetupPart(context, source=source, progress=progress, preview=serve, resumes=True)
        self._setup = part.setup
        bar = SetupBar(context, self._setup, drop=self.host.drop_commands)
        self.host.windows.leave_open_as_stop(bar.button)
        self.host.add_parts(part, bar)
        self.host.start()

    @property
    def last_port(self) -> str | None:
        """The port of the last arm that was connected; None without one, or on a machine."""
        return self._setup.port


def serve_setup(
    host: str = "127.0.0.1",
    port: int | None = None,
    *,
    allow_remote: bool = False,
    ports: Collection[str] = (),
    reply_timeout: float = REPLY_TIMEOUT,
    machine: Machine | None = None,
    progress_file: Path | None = None,
    key_of: KeyOf = new_key,
) -> SetupApp:
    """Serve the setup app.

    Args:
        host: Address to listen on.
        port: Port to listen on; 0 for any free one; None for 8080 or the next free one after it.
        allow_remote: Whether ``host`` may be more than this machine's loopback.
        ports: Serial ports to look at instead of all there are.
        reply_timeout: How long a motor may take to answer beyond the time on the wire [s].
        machine: The machine to set up, which needs a calibration sensor; closed by its owner.
        progress_file: Keeps the progress of the setup; the terminal's file by default.
        key_of: As for ``start_guarded``.

    Returns:
        The running app; its ``url`` is the link that opens it.

    Raises:
        CalibrationError: This user has no place for files.
        ConfigError: The host or port cannot be used.
        GuardError: The server answered a request without the key; it is stopped again.
    """
    known = None if machine is None else known_arm(machine)
    source = known or ports_of(tuple(ports), reply_timeout)
    kept = SetupProgress(progress_file or own_folder() / NAME, source.where)
    server = start_guarded(
        host, port, allow_remote=allow_remote, label="SO-101 setup", key_of=key_of
    )
    try:
        return SetupApp(server, source=source, progress=kept)
    except BaseException:
        server.close()
        raise
