"""Record a motion as one HTML file that plays offline in any browser, with viser's player.

viser records what a server sends, so a server without clients is started to draw it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path

import numpy as np
import viser

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array
from so101_motion.files import atomic
from so101_motion.files.trajectory_export import Run
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.request import Plan

from ..page import texts
from ..page.plan_view import PlanView, plan_view
from ..page.target_ik import TargetSolver
from ..scene.camera_and_lights import Sight, set_up_recording
from ..scene.robot_view import Line, RobotView, segments
from ..scene.scene_view import SceneView
from ..server.guarded_server import start_guarded
from ..server.head import NOTICE, front_file
from ..server.request_policy import POLICY

FRAMES = 30.0  # pictures a second; chosen, it looks smooth and keeps the file small
_PAUSE = 0.8  # how long the arm rests at both ends before the player begins again [s]; chosen

_PATH = (240, 140, 0)
_GHOST, _GHOST_OPACITY = (60, 130, 246), 0.3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovedArm:
    """How an arm moves by its plan, or has moved."""

    view: PlanView
    run: Run | None = None  # how the plan was carried out; None for the plan alone
    # where its base stands in the frame of a scene that it shares with others
    T_scene_base: SE3 = field(default_factory=SE3.identity)

    @property
    def duration(self) -> float:
        """How long it moves [s]."""
        return float((self.view.plan.trajectory if self.run is None else self.run).t[-1])

    def at(self, t: Array) -> tuple[Array, Array]:
        """Configurations and ghosts, shape (m, 5), at times (m,); it rests once it has arrived.

        The ghost of a plan stands at the goal; that of a run moves as planned.
        """
        if self.run is not None:
            return _at(t, self.run.t, self.run.q), _at(t, self.run.t, self.run.q_ref)
        trajectory, q_goal = self.view.plan.trajectory, self.view.plan.q_goal
        return _at(t, trajectory.t, trajectory.q), np.tile(q_goal, (len(t), 1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Film:
    """A motion of one arm or several to be recorded.

    The arms have the names that ``holder_of`` gives; that of a single one is empty.
    """

    title: str
    arms: Mapping[str, MovedArm]

    def times(self) -> Array:
        """When there is a picture [s]: ``FRAMES`` a second, both ends included."""
        end = max(each.duration for each in self.arms.values())
        return np.append(np.arange(0.0, end, 1.0 / FRAMES), end)

    def facts(self) -> tuple[tuple[str, str], ...]:
        first = next(iter(self.arms.values()))
        return (
            ("Motion", f"{first.view.name}, {first.view.made_at:%Y-%m-%d %H:%M}"),
            *(fact for name, each in self.arms.items() for fact in _figures(name, each.view)),
            ("Limits", texts.caps(first.view.plan.limits)),
            ("Orange line", "path of the tool"),
            ("Blue arm", "the goal" if first.run is None else "as planned; the orange as measured"),
        )

    def scene(self) -> Scene:
        first = next(iter(self.arms.values()))
        seen, T = first.view.scene, first.T_scene_base
        if list(self.arms) == [""]:
            return seen
        arms = ((name, arm.view.scene.attached) for name, arm in self.arms.items())
        return Scene(
            obstacles=tuple(
                replace(each, T_base_obstacle=T @ each.T_base_obstacle) for each in seen.obstacles
            ),
            attached=tuple(replace(each, holder=name) for name, held in arms for each in held),
            floor_z=None if seen.floor_z is None else seen.floor_z + float(T.p[2]),
        )


def _figures(name: str, view: PlanView) -> list[tuple[str, str]]:
    if name:
        figures = dict(texts.plan_facts(view))
        return [(name, f"{figures['Duration']}, clearance {figures['Clearance']}")]
    figures = {**dict(texts.plan_facts(view)), "Gripper": texts.opening(view.q_jaw)}
    return [fact for fact in figures.items() if fact[0] != "Planned in"]


def film_of_plan(plan: Plan, scene: Scene, *, title: str, q_jaw: float) -> Film:
    """Make a film of a plan that no page shows."""
    model = RobotModel.load()
    solver = TargetSolver(scene, (model.lower, model.upper))
    view = plan_view(plan, solver, "tool", scene=scene, q_jaw=q_jaw)
    return Film(title=title, arms={"": MovedArm(view=view)})


def write_recording(film: Film, path: Path) -> None:
    """Write ``film`` as an HTML file; ``ConfigError`` if that cannot be done."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise ConfigError("html", str(path), "must end with .html, for browsers to play it")
    atomic.save("html", path, recording(film))


def recording(film: Film) -> bytes:
    """``film`` as one HTML file that needs nothing else."""
    model = RobotModel.load()
    server = start_guarded(port=0)
    try:
        bases = [each.T_scene_base for each in film.arms.values()]
        set_up_recording(server.viser, Sight.of_arms(tuple(bases)))
        return _dressed(_played(server.viser, film, model), film).encode()
    finally:
        server.close()


def _played(server: viser.ViserServer, film: Film, model: RobotModel) -> str:
    stage, around = server.scene, SceneView(server.scene)
    drawn = {
        name: _DrawnArm(stage, each, f"/arms/{k}")
        for k, (name, each) in enumerate(film.arms.items())
    }
    t, scene = film.times(), film.scene()
    courses = {name: each.at(t) for name, each in film.arms.items()}

    def draw(k: int) -> None:
        tools = {}
        for name, each in drawn.items():
            q, q_ghost = courses[name]
            tools[name] = each.draw(model, q[k], q_ghost[k])
        around.show(scene, tools)

    draw(0)
    tape = server.get_scene_serializer()
    tape.insert_sleep(_PAUSE)
    for k in range(1, len(t)):
        tape.insert_sleep(float(t[k] - t[k - 1]))
        draw(k)
    tape.insert_sleep(_PAUSE)
    return tape.as_html()


class _DrawnArm:
    """An arm, its ghost and its path."""

    def __init__(self, stage: viser.SceneApi, moved: MovedArm, node: str) -> None:
        self._T_base, self._q_jaw = moved.T_scene_base, moved.view.q_jaw
        stage.add_frame(
            node,
            show_axes=False,
            position=self._T_base.p,
            wxyz=self._T_base.quaternion_wxyz(),
        )
        self._arm = RobotView(stage, f"{node}/arm")
        self._ghost = RobotView(stage, f"{node}/ghost", color=_GHOST, opacity=_GHOST_OPACITY)
        Line(stage, f"{node}/path").show(segments(moved.view.plan.tool_path), _PATH, 4.0)

    def draw(self, model: RobotModel, q: Array, q_ghost: Array) -> SE3:
        """Draw arm and ghost; returns where the tool is in the scene."""
        T_arm = model.link_placements(q, self._q_jaw)
        self._arm.move(T_arm)
        self._ghost.move_beside(model.link_placements(q_ghost, self._q_jaw), T_arm)
        return self._T_base @ model.frame(q)


def _dressed(player: str, film: Film) -> str:
    """The player with a title, the figures and the policy; every text is escaped."""
    title = escape(film.title)
    allowed = POLICY.format(connect="data: blob:")
    policy = f'<meta http-equiv="Content-Security-Policy" content="{allowed}">'
    player = re.sub(r"<title>.*?</title>", "", player, count=1, flags=re.DOTALL)
    player = player.replace(_LIGHT, _AS_WISHED, 1)
    head = player.index("<head>") + len("<head>")
    body = player.rindex("</body>")
    facts = film.facts()
    rows = "".join(f"<i>{escape(name)}</i><span>{escape(value)}</span>" for name, value in facts)
    return (
        f"{player[:head]}{policy}<title>{title}</title><script>{front_file(NOTICE)}</script>"
        f"{player[head:body]}<style>{front_file('film.css')}</style>"
        f'<div id="so101-card"><b>{title}</b><div>{rows}</div></div>{player[body:]}'
    )


_LIGHT = "__VISER_EMBED_CONFIG__={darkMode:false}"
_AS_WISHED = "__VISER_EMBED_CONFIG__={darkMode:matchMedia('(prefers-color-scheme: dark)').matches}"
"""viser fixes the colour scheme when a film is made; ours follows the viewer's system setting."""


def _at(t: Array, known: Array, values: Array) -> Array:
    """Columns of values known at some times, straight in between, at other times."""
    return np.column_stack([np.interp(t, known, column) for column in values.T])
