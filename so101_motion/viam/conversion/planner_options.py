"""Read the planner's options from a request's ``extra``.

Options of viam-server's planner that ours has not are ignored, each with one warning. A wrong value
is refused: a misspelt metric that silently means "the whole pose" costs people an afternoon.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace

from viam.proto.common import PoseCloud as ViamCloud

from so101_motion.common.attributes import Attribute, Attributes, checked_number, suggest
from so101_motion.common.errors import ConfigError
from so101_motion.common.units import to_deg, to_m, to_mm, to_rad
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import GoalMetric, PoseCloud, PoseGoal
from so101_motion.planning.request import MOST_ROUTES, ROUTE_EFFORT, Search
from so101_motion.viam.conversion import convert

_IGNORED = frozenset({
    "max_ik_solutions", "min_ik_score", "resolution", "goal_threshold", "frame_step",
    "input_ident_dist", "iter_before_rand", "position_seeds", "return_partial_plan",
    "configuration_distance_metric", "meshes_as_octrees", "collect_solution_diagnostics",
    "waypoints", "start_state",
})  # fmt: skip
"""Options of viam-server's planner that have no effect on ours."""

REPLAN = "replan"

_OPTIONS = (
    Attribute("goal_metric_type", kind="own"),
    Attribute("pose_cloud", kind="own"),
    Attribute("position_tolerance_mm", unit="mm", range=(0.0, 1000.0), zero_is_none=True),
    Attribute("orientation_tolerance_deg", unit="deg", range=(0.0, 180.0), zero_is_none=True),
    Attribute("timeout", unit="s", range=(0.0, 600.0), zero_is_none=True),
    Attribute("rseed", kind="whole", range=(0.0, 2.0**31), default=0),
    Attribute("route_effort", kind="whole", range=(1.0, MOST_ROUTES), default=ROUTE_EFFORT),
    Attribute("collision_buffer_mm", unit="mm", range=(0.0, 100.0), zero_is_none=True),
    Attribute(REPLAN, kind="flag", default=False),
)
"""Options that have an effect."""

_USED = tuple(each.name for each in _OPTIONS)

_MOST_LOOKED_AT = 20  # unknown options of a request that are compared with ours; chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannerOptions:
    """The planner options of one request; None for the arm's, the planner's or the scene's own."""

    metric: GoalMetric = GoalMetric.POSITION_ONLY
    position_tolerance: float | None = None
    orientation_tolerance: float | None = None
    seed: int = 0
    time_budget: float | None = None
    route_effort: int = ROUTE_EFFORT
    margin: float | None = None
    cloud: PoseCloud | None = None
    replan: bool = False

    @classmethod
    def of(cls, extra: Mapping[str, object]) -> PlannerOptions:
        given = Attributes({key: extra[key] for key in _USED if key in extra}, _OPTIONS)
        return cls(
            metric=convert.from_goal_metric(extra),
            position_tolerance=given.value("position_tolerance_mm"),
            orientation_tolerance=given.value("orientation_tolerance_deg"),
            seed=given.value("rseed"),
            time_budget=given.value("timeout"),
            route_effort=given.value("route_effort"),
            # ``search`` uses it only if it is wider than the scene's own margin.
            margin=given.value("collision_buffer_mm"),
            cloud=cloud_in(extra),
            replan=given.value(REPLAN),
        )

    def goal(self, goal: PoseGoal) -> PoseGoal:
        return replace(
            goal,
            metric=self.metric,
            position_tolerance=self.position_tolerance or goal.position_tolerance,
            approach_tolerance=self.orientation_tolerance or goal.approach_tolerance,
            cloud=self.cloud,
        )

    def search(self, scene: Scene) -> Search:
        if self.margin is not None and self.margin > scene.margin:  # a copy takes 0.2 ms and more
            scene = replace(scene, margin=self.margin)
        search = Search(scene=scene, seed=self.seed, route_effort=self.route_effort)
        return replace(search, time_budget=self.time_budget or search.time_budget)


def from_goal_cloud(cloud: ViamCloud) -> PoseCloud:
    """Convert Viam's pose cloud to ours: metres and radians."""
    names = ("x", "y", "z", "o_x", "o_y", "o_z", "theta")
    return _pose_cloud({name: getattr(cloud, name) for name in names})


def to_goal_cloud(cloud: PoseCloud) -> ViamCloud:
    """Convert a pose cloud to Viam's: millimetres and degrees."""
    lengths_mm = {name: to_mm(getattr(cloud, name)) for name in ("x", "y", "z")}
    shares = {name: getattr(cloud, name) for name in ("o_x", "o_y", "o_z")}
    return ViamCloud(**lengths_mm, **shares, theta=to_deg(cloud.theta))


def cloud_in(extra: Mapping[str, object]) -> PoseCloud | None:
    """The ``pose_cloud`` of a request, if it has one; refused beside a metric."""
    value = extra.get("pose_cloud")
    if value is None:
        return None
    if "goal_metric_type" in extra:
        raise ConfigError(
            "pose_cloud", value, "cannot be given together with goal_metric_type; give one of them"
        )
    if not isinstance(value, Mapping):
        raise ConfigError("pose_cloud", value, 'must be an object such as {"x": 3, "theta": 180}')
    keys = {"x": "x", "y": "y", "z": "z", "ox": "o_x", "oy": "o_y", "oz": "o_z", "theta": "theta"}
    given = Attributes(value, keys, kind="key of pose_cloud")
    return _pose_cloud(
        {name: given.number(key, 0.0, lower=0.0, upper=float("inf")) for key, name in keys.items()}
    )


def _pose_cloud(values: Mapping[str, float]) -> PoseCloud:
    for key, value in values.items():
        checked_number(f"pose_cloud.{key}", value, lower=0.0)
    shares = {name: to_m(values[name]) for name in ("x", "y", "z")}
    shares |= {name: values[name] for name in ("o_x", "o_y", "o_z")}
    return PoseCloud(**shares, theta=to_rad(values["theta"]))


class OptionWarnings:
    """Warns once of each option that has no effect, misspelt ones included."""

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._said: set[str] = set()

    def warn(self, extra: Mapping[str, object]) -> None:
        for key in sorted(_IGNORED & extra.keys() - self._said):
            self._said.add(key)
            self._logger.warning('planner option "%s" has no effect on our planner', key)
        unknown = sorted(extra.keys() - self._said - {*_USED})
        for key in unknown[:_MOST_LOOKED_AT]:
            hint = suggest(key, _USED)
            if hint.startswith("did you mean"):  # others may be meant for somebody else
                self._said.add(key)
                self._logger.warning('"%s" is unknown and has no effect; %s', key, hint)
