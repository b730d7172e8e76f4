"""``so101 view`` and ``so101 demo``: serve the page for an arm, a machine's arm or a cell."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import click
import numpy as np

from so101_motion.cli.options import flag, option, together, verb
from so101_motion.cli.param_types import IN_FILE, PORT, read_scene
from so101_motion.cli.plan_move import plan_table
from so101_motion.cli.shared import aside, import_preview, note_opened, stops_on_ctrl_c
from so101_motion.cli.sources import (
    ARM_OR_CELL,
    AnySource,
    CellSource,
    MachineSource,
    Source,
    end_as_asked,
    ending,
)
from so101_motion.common.realtime import LOOK_FOR_SIGNALS
from so101_motion.common.units import in_mm, to_mm

if TYPE_CHECKING:
    from so101_motion.common.geometry import Array
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.rig.protocols import RigLike


_FIRST_TRY = 5.0  # how long a machine may take to answer before the link is printed [s]; chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """The address and options of the page."""

    host: str
    web_port: int | None  # None for 8080 or the next free one after it
    allow_remote: bool
    no_browser: bool
    new_link: bool

    def server(self, what: str) -> dict[str, Any]:
        """The arguments of ``start_guarded`` for the page of ``what``.

        Its key is that of its last start on the same port.
        """
        from so101_viewer.server import kept_key

        def key(port: int) -> str:
            if self.web_port == 0:  # another port with every start
                return str(kept_key.new_key())
            return str(kept_key.key_for(what, port, is_new=self.new_link))

        address = {"host": self.host, "port": self.web_port, "allow_remote": self.allow_remote}
        return {**address, "key_of": key}


PAGE = together(
    Page,
    host=option("Address the page listens on.", default="127.0.0.1"),
    web_port=option("Port the page listens on.", int, show_default="8080, or the next free one"),
    allow_remote=flag("Allow a --host that other computers can reach."),
    no_browser=flag("Only print the link."),
    new_link=flag("Make the links of earlier starts invalid."),
)


@verb()
def demo(
    text: bool = flag("Show a plan and the move in the terminal, no browser."),
    arms: int = option(
        "Number of arms; they share the space and keep apart.", click.IntRange(1, 10), 1
    ),
    page: Page = PAGE,
) -> None:
    """Run the simulated arm with its page in the browser; needs no hardware."""
    if text and arms > 1:
        raise click.UsageError("--text shows a single arm; leave out --arms")
    if text:
        _demo_in_text()
    elif arms > 1:
        from so101_motion.files.cell_file import arms_in_a_circle

        file = arms_in_a_circle(arms)
        show(CellSource(file=file, title=f"{arms} simulated arms"), page)
    else:
        show(Source(port=None), page, scene=cube_and_tray(), place="tray")


def cube_and_tray() -> Scene:
    """What is around the demo's arm."""
    from so101_motion.common.geometry import SE3
    from so101_motion.planning.collision.scene import FLOOR_Z, Box, Obstacle, Scene

    def lying(
        name: str, size: tuple[float, ...], x: float, y: float, mass: float | None
    ) -> Obstacle:
        T = SE3.from_translation((x, y, FLOOR_Z + 0.5 * size[2]))
        return Obstacle(name=name, shape=Box(size=np.array(size)), T_base_obstacle=T, mass=mass)

    cube = lying("cube", (0.025, 0.025, 0.025), 0.24, -0.09, 0.02)
    return Scene(obstacles=(cube, lying("tray", (0.09, 0.09, 0.005), 0.11, -0.2, None)))


def _demo_in_text() -> None:
    from so101_motion.planning.goals import PoseGoal
    from so101_motion.rig.simulated_rig import open_simulated

    p_wanted = np.array([0.250, 0.120, 0.150])
    x_mm, y_mm, z_mm = to_mm(p_wanted)
    with note_opened("simulated arm", open_simulated()) as rig:
        plan = rig.arm.plan(PoseGoal.at_point(p_wanted))
        click.echo(f"Simulated arm: move the tool to ({x_mm:g}, {y_mm:g}, {z_mm:g}) mm\n")
        click.echo(plan_table(plan))
        click.echo("\nmoving ...", nl=False)
        sys.stdout.flush()
        motion = rig.arm.move(plan, wait=False)
        with stops_on_ctrl_c(rig.arm):
            motion.result()
        p = rig.arm.T_base().p
        where, off_mm = in_mm(p), to_mm(float(np.linalg.norm(p - p_wanted)))
        click.echo(f" arrived at {where}, {off_mm:.2f} mm off (simulated)")
        click.echo("\nnext: so101 demo        the same in the browser")


@verb()
def view(
    source: AnySource | CellSource = ending(ARM_OR_CELL),
    scene_file: Path | None = option(
        "A scene file: the obstacles around the arm, as for so101 plan.", IN_FILE, name="--scene"
    ),
    leader: str | None = option(
        'An arm that this one can follow: its serial port, or "sim". Start it on the Teach tab.',
        PORT,
    ),
    camera: str | None = option(
        "Camera shown over the scene: the URL of a picture or of an MJPEG stream, or a camera of"
        " the machine.",
        metavar="CAMERA",
    ),
    atlas: Path | None = option(
        "Show the arm's reach as cubes: a folder that so101 sweep reach made.",
        click.Path(path_type=Path, exists=True, file_okay=False),
    ),
    leader_calibration: Path | None = option(
        "The leader's calibration file.", click.Path(path_type=Path)
    ),
    page: Page = PAGE,
) -> None:
    """See, plan and move the arm in the browser; opening the page moves nothing.

    \b
    so101 view --sim
    so101 view --port /dev/ttyACM0
    so101 view --machine my-arm.local:8080
    so101 view --port /dev/ttyACM0 --leader /dev/ttyACM1
    so101 view --cell cell.json

    The page opens even if the arm is not connected yet, and reconnects when it was lost. With
    --at-end the arm goes home, or is parked or let go of, when you end this.
    """  # noqa: D301
    if isinstance(source, CellSource):
        if any((scene_file, leader, atlas)):
            raise click.UsageError(
                "--scene, --leader and --atlas need a single arm; leave them out"
            )
        return show(source, page, scene_file=source.path, camera=camera)
    leads = None
    if leader is not None:
        from so101_motion.drivers.port.port_list import device_of

        if not isinstance(source, Source):
            raise click.UsageError("--leader works only with --port or --sim; leave it out")
        if source.port and device_of(leader) == device_of(source.port):
            raise click.UsageError("--leader and --port must be two arms")
        port = None if leader == "sim" else leader
        leads = Source(port=port, calibration_file=leader_calibration)
    show(source, page, scene_file=scene_file, leader=leads, camera=camera, atlas=atlas)


def show(
    source: AnySource | CellSource,
    page: Page,
    *,
    scene: Scene | None = None,
    scene_file: Path | None = None,
    leader: Source | None = None,
    camera: str | None = None,
    atlas: Path | None = None,
    place: str = "",
) -> None:
    """Serve the page until Ctrl-C; it saves changes of scene or cell to ``scene_file``.

    ``scene`` is around a single arm instead of what is in that file; ``place`` is where the page
    proposes to put its items.
    """
    from so101_motion.arm.planning_worker import planner_started

    with planner_started():
        viewer, is_cell = import_preview(), isinstance(source, CellSource)
        if camera is not None:
            from so101_viewer.panels.camera_panel import check_camera

            check_camera(camera, has_machine=not isinstance(source, (Source, CellSource)))
        scene = scene if is_cell or scene else read_scene(scene_file)
        if scene is not None and isinstance(source, Source) and source.port is None:
            source = replace(source, q_start=_free_pose(scene))
        reach = None
        if atlas is not None:
            from so101_motion.tasks.sweeps.atlas import Atlas

            reach = Atlas.read(atlas)
        arm = viewer.Source(
            title=source.title,
            open=source.open if isinstance(source, CellSource) else _opener(source, scene),
            scene_file=scene_file,
            open_leader=None if leader is None else leader.open,
            camera=camera,
            atlas=reach,
            place=place,
        )
        with viewer.serve(arm, **page.server(source.title)) as preview:
            if isinstance(source, MachineSource):
                preview.await_first_try(_FIRST_TRY)
                if preview.wrong is not None:  # told alone, without a link to a page that is gone
                    raise preview.wrong
            aside(f"so101: {source.what}")
            keep_open(preview, page)


def keep_open(served: Any, page: Page) -> None:
    """Print the page's link, open it in a browser if there is a screen, and wait for Ctrl-C.

    Raises what is wrong if the page can never show its arm.
    """
    from so101_viewer.server.guarded_server import DEFAULT_PORT

    port = urlsplit(served.url).port
    if page.web_port is None and port != DEFAULT_PORT:
        aside(f"so101: port {DEFAULT_PORT} is taken, so the page is on port {port}")
    click.echo(f"open   {served.url}")
    aside("       (anyone with this link can move the arm; Ctrl-C to quit)")
    if not page.no_browser and _has_screen():
        import webbrowser

        webbrowser.open(served.url_for_once())
    while served.wrong is None:
        time.sleep(LOOK_FOR_SIGNALS)
    raise served.wrong


def _opener(source: AnySource, scene: Scene | None) -> Callable[[], RigLike]:
    """A function that opens the arm; it is called until it succeeds, and prints each text once."""
    printed: set[str] = set()

    def say(text: str) -> None:
        if text not in printed:
            printed.add(text)
            aside(text)

    quiet = replace(source, say=say) if isinstance(source, Source) else source

    def opened() -> RigLike:
        rig: RigLike = quiet.open_to_look()
        if scene is not None:
            rig.arm.scene = scene
        end_as_asked(source.at_end, rig)
        return rig

    return opened


def _free_pose(scene: Scene) -> Array | None:
    """The first named pose that is free of contact in ``scene``; None if none is."""
    from so101_motion.arm.gripper import JAW_CLOSED
    from so101_motion.common.named_poses import POSES
    from so101_motion.planning.collision.collision import CollisionModel
    from so101_motion.planning.kinematics.model import RobotModel

    contact = CollisionModel(RobotModel.load(), scene).first_contact
    return next((pose.q for pose in POSES if contact(pose.q, JAW_CLOSED) is None), None)


def _has_screen() -> bool:
    """Whether a browser started here would open in a window."""
    if not sys.stdout.isatty() or "SSH_CONNECTION" in os.environ:
        return False
    return sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
