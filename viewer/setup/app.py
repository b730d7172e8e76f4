"""The setup on a page of its own: ``so101 setup --web``. No arm need be there yet."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from so101_motion.adapters import PATIENCE, own_folder
from so101_motion.calib.progress import NAME, Progress
from so101_motion.machine import MachineSensor

from ..guard import GuardedServer, start_guarded
from ..host import Host
from ..studio import furnish
from .benches import Given, Ports, given_by
from .part import SetupPart
from .stop import StopPanel


class SetupApp:
    """A setup that is being served. Use it in a ``with`` block or call ``close``.

    Args:
        server: Where the page is.
        ports: Where the arm may be.
        fixed: The arm, if that is not to be chosen.
        progress: How far an earlier setup came.

    Attributes:
        host: What runs it.
        url: The link that opens it.
    """

    def __init__(
        self, server: GuardedServer, *, ports: Ports, fixed: Given | None, progress: Progress
    ) -> None:
        self.url, self._server = server.url, server
        self.host = Host(server)
        counter = self.host.counter()
        furnish(counter.server)
        setup = SetupPart(counter, ports=ports, fixed=fixed, progress=progress, resumes=True)
        stop = StopPanel(counter, setup.shop, drop=self.host.drop_commands)
        self.host.windows.leave_open_as_stop(*stop.widgets)
        self.host.take(setup, stop)
        self.host.start()

    def url_for_once(self) -> str:
        """A link that opens the page once; see ``GuardedServer.url_for_once``."""
        return self._server.url_for_once()

    def close(self) -> None:
        """Stop serving; a calibration under way is put back. May be called twice."""
        self.host.close()

    def __enter__(self) -> SetupApp:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def serve_setup(
    host: str = "127.0.0.1",
    port: int = 8080,
    *,
    allow_remote: bool = False,
    ports: Collection[str] = (),
    patience: float = PATIENCE,
    sensor: MachineSensor | None = None,
    progress_file: Path | None = None,
) -> SetupApp:
    """Serve the setup app.

    Args:
        host: Address to listen on.
        port: Port to listen on; 0 for any free one.
        allow_remote: Whether ``host`` may be more than this machine's loopback.
        ports: Serial ports to look at instead of all there are.
        patience: How long a motor may take to answer beyond the time on the wire [s].
        sensor: The calibration sensor of a machine whose motors are meant; closed by its owner.
        progress_file: Where it is kept how far the setup is; the terminal's file by default.

    Returns:
        The running app; its ``url`` is the link that opens it.

    Raises:
        CalibrationError: This user has no place for files.
        ConfigError: The host or port cannot be used.
        GuardError: The server let a stranger in; it is stopped again.
    """
    fixed = None if sensor is None else given_by(sensor)
    kept = Progress(progress_file or own_folder() / NAME, fixed.where if fixed else None)
    server = start_guarded(host, port, allow_remote=allow_remote, label="SO-101 setup")
    try:
        where = Ports(named=tuple(ports), patience=patience)
        return SetupApp(server, ports=where, fixed=fixed, progress=kept)
    except BaseException:
        server.close()
        raise
