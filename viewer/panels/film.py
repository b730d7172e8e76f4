"""Record a motion as one HTML file that plays offline in any browser.

The file holds viser's player, the arm, the scene and the motion, and its content policy allows no
connections. viser records what a server sends, so a server without clients is started to draw it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
import viser

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array, frozen_array
from so101_motion.files import atomic
from so101_motion.files.trajectory_export import Run
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.request import Plan

from ..page import texts
from ..page.screen_state import PlanView
from ..page.target_ik import Surroundings, TargetSolver
from ..scene.camera_and_lights import set_up_recording
from ..scene.plan_view import plan_view
from ..scene.robot_view import RobotView, looks_different, segments
from ..scene.scene_view import SceneView
from ..server.guarded_server import start_guarded
from ..server.head import NOTICE, script

FRAMES = 30.0
"""Pictures a second; chosen, it looks smooth and keeps the file small."""

_PAUSE = 0.8
"""How long the arm rests at both ends before the player begins again [s]; chosen."""

_PATH = (240, 140, 0)
_GHOST, _GHOST_OPACITY = (60, 130, 246), 0.3

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; worker-src blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Film:
    """The content of a recording.

    Attributes:
        title: What it is called.
        facts: Figures, as names and values.
        scene: What stands around the arm and what it holds.
        t: Times of the configurations, from 0 up, shape (n,), [s].
        q: Where the arm is then, shape (n, 5), [rad].
        q_ghost: Where its ghost is, shape (n, 5) or (5,), [rad].
        q_jaw: Jaw angle [rad].
        path: Points of the tool path in the base frame, shape (k, 3), [m].
    """

    title: str
    facts: tuple[tuple[str, str], ...]
    scene: Scene
    t: Array
    q: Array
    q_ghost: Array
    q_jaw: float
    path: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", frozen_array(self.t, (-1,)))
        n = len(self.t)
        object.__setattr__(self, "q", frozen_array(self.q, (n, 5)))
        object.__setattr__(self, "q_ghost", frozen_array(np.broadcast_to(self.q_ghost, (n, 5))))
        object.__setattr__(self, "path", frozen_array(self.path, (-1, 3)))

    def frames(self) -> tuple[Array, Array, Array]:
        """Times (m,), configurations and ghosts (m, 5), ``FRAMES`` a second, both ends included."""
        end = float(self.t[-1])
        t = np.append(np.arange(0.0, end, 1.0 / FRAMES), end)
        return t, _at(t, self.t, self.q), _at(t, self.t, self.q_ghost)


def film_of(view: PlanView, *, title: str, run: Run | None = None) -> Film:
    """Make a film of a plan: the arm moves along it, and its ghost waits at the goal.

    Args:
        view: What to show.
        title: Which arm it is, or what it does.
        run: How the plan was carried out; the arm then goes as measured, its ghost as planned.
    """
    trajectory = view.plan.trajectory
    facts = [
        ("Motion", f"{view.name}, {view.made_at:%Y-%m-%d %H:%M}"),
        *(fact for fact in texts.plan_facts(view) if fact[0] != "Planned in"),
        ("Limits", texts.caps(view.plan.limits)),
        ("Gripper", texts.opening(view.q_jaw)),
        ("Orange line", "path of the tool"),
        ("Blue arm", "the goal" if run is None else "as planned; the orange one as measured"),
    ]
    return Film(
        title=title,
        facts=tuple(facts),
        scene=view.scene,
        t=trajectory.t if run is None else run.t,
        q=trajectory.q if run is None else run.q,
        q_ghost=view.plan.q_goal if run is None else run.q_ref,
        q_jaw=view.q_jaw,
        path=view.plan.tool_path,
    )


def film_of_plan(plan: Plan, scene: Scene, *, title: str, q_jaw: float) -> Film:
    """Make a film of a plan that no page shows."""
    model = RobotModel.load()
    solver = TargetSolver.load(Surroundings(scene=scene, range=(model.lower, model.upper)))
    return film_of(plan_view(plan, solver, "tool", scene=scene, q_jaw=q_jaw), title=title)


def write_recording(film: Film, path: Path) -> None:
    """Write ``film`` as an HTML file.

    Raises:
        ConfigError: The file cannot be written.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise ConfigError("html", str(path), "must end with .html, for browsers to play it")
    try:
        atomic.write(path, recording(film))
    except OSError as error:
        raise ConfigError("html", str(path), f"cannot be written: {error.strerror}") from error


def recording(film: Film) -> bytes:
    """``film`` as one HTML file that needs nothing else."""
    model = RobotModel.load()
    server = start_guarded(port=0)
    try:
        set_up_recording(server.viser)
        return _dressed(_played(server.viser, film, model), film).encode()
    finally:
        server.close()


def _played(server: viser.ViserServer, film: Film, model: RobotModel) -> str:
    """The player with the motion in it, as viser makes it."""
    stage = server.scene
    arm = RobotView(stage, "/arm")
    ghost = RobotView(stage, "/ghost", color=_GHOST, opacity=_GHOST_OPACITY)
    around = SceneView(stage)
    if len(film.path) > 1:
        pieces = segments(film.path)
        stage.add_line_segments("/path", pieces, _PATH, thickness=4.0, thickness_units="screen")

    def draw(q: Array, q_ghost: Array) -> None:
        T_arm = model.link_placements(q, film.q_jaw)
        arm.move(T_arm)
        around.show(film.scene, model.frame(q))
        if not np.array_equal(q_ghost, ghost_at):
            T_ghost.update(model.link_placements(q_ghost, film.q_jaw))
            ghost.move(T_ghost)
            ghost_at[:] = q_ghost
        ghost.show({link for link in T_ghost if looks_different(T_ghost[link], T_arm[link])})

    ghost_at, T_ghost = np.full(5, np.nan), dict[str, SE3]()
    t, q, q_ghost = film.frames()
    draw(q[0], q_ghost[0])
    tape = server.get_scene_serializer()
    tape.insert_sleep(_PAUSE)
    for k in range(1, len(t)):
        tape.insert_sleep(float(t[k] - t[k - 1]))
        draw(q[k], q_ghost[k])
    tape.insert_sleep(_PAUSE)
    return tape.as_html()


def _dressed(player: str, film: Film) -> str:
    """The player with a title, the figures and the policy; every text is escaped."""
    title = escape(film.title)
    policy = f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
    player = re.sub(r"<title>.*?</title>", "", player, count=1, flags=re.DOTALL)
    player = player.replace(_LIGHT, _AS_WISHED, 1)
    head = player.index("<head>") + len("<head>")
    body = player.rindex("</body>")
    return (
        f"{player[:head]}{policy}<title>{title}</title><script>{script(NOTICE)}</script>"
        f"{player[head:body]}"
        f"{_card(title, film.facts)}{player[body:]}"
    )


_LIGHT = "__VISER_EMBED_CONFIG__={darkMode:false}"
_AS_WISHED = "__VISER_EMBED_CONFIG__={darkMode:matchMedia('(prefers-color-scheme: dark)').matches}"
"""viser fixes the colour scheme when a film is made; ours follows the viewer's system setting."""

_CARD_STYLE = """<style>
#so101-card { position: fixed; left: 14px; top: 14px; z-index: 1; pointer-events: none;
  max-width: min(26em, calc(100vw - 28px)); box-sizing: border-box; padding: .8em 1em;
  border-radius: .5em; background: rgba(255, 255, 255, .88); color: #212529;
  font: 14px/1.45 system-ui, sans-serif; overflow-wrap: anywhere;
  box-shadow: 0 1px 6px rgba(0, 0, 0, .15) }
#so101-card b { display: block; font-size: 1.15em; margin-bottom: .3em }
#so101-card div { display: grid; grid-template-columns: max-content 1fr; gap: .1em 1em }
#so101-card i { font-style: normal; opacity: .65 }
@media (prefers-color-scheme: dark) {
  #so101-card { background: rgba(36, 36, 36, .88); color: #dee2e6 }
}
@media (max-width: 600px) { #so101-card { font-size: 12px } }
@media (max-aspect-ratio: 1) { #so101-card { top: auto; bottom: 62px } }
.mantine-Notifications-root {
  top: auto !important; left: auto !important; bottom: 60px; right: 12px;
}
@media (max-aspect-ratio: 1) {
  .mantine-Notifications-root { top: 12px !important; bottom: auto !important }
}
</style>"""


def _card(title: str, facts: Iterable[tuple[str, str]]) -> str:
    rows = "".join(f"<i>{escape(name)}</i><span>{escape(value)}</span>" for name, value in facts)
    return f'{_CARD_STYLE}<div id="so101-card"><b>{title}</b><div>{rows}</div></div>'


def _at(t: Array, known: Array, values: Array) -> Array:
    """Columns of values known at some times, straight in between, at other times."""
    return np.column_stack([np.interp(t, known, column) for column in values.T])
