"""Plan to pass an object from one arm's gripper to another's.

Three motions, all of them planned and proven before anything moves. *Approach*: all arms move
together, the giver to where the object can be taken, the taker to a place before it. *Take*: the
taker goes straight to the object with its jaw open. It closes, the giver opens, and *leave*: the
giver goes straight back. ``meetings.py`` finds where the arms meet, and how the object is
taken.

The taker's gripper and jaw may touch the object from the straight line to it on, the giver's until
it has left. There is no other exception: the arms themselves always keep apart, and the object
keeps off everything else. It is held by the giver, then by both, each counting all of its weight,
then by the taker.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import islice

import coal
import numpy as np

from so101_motion.common.errors import ConfigError, NoPath, PlanningError, So101Error
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.units import to_rad
from so101_motion.planning.cell.meetings import Grasp, Meeting, Meetings, grasps_of
from so101_motion.planning.cell.team_requests import Handover, HandoverRequest, TeamMember
from so101_motion.planning.cell.together import plan_together
from so101_motion.planning.collision.apart import ROOM, first_meeting
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.bodies import hull_of
from so101_motion.planning.collision.coal_shapes import placed
from so101_motion.planning.collision.course import Course
from so101_motion.planning.collision.scene import Attached
from so101_motion.planning.goals import GoalMetric, JointGoal, LineGoal, PoseGoal
from so101_motion.planning.kinematics.model import GRIPPER_LINK, JAW_LINK, RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import Plan

BEFORE = 0.06  # straight line to the object and away from it [m]; chosen, the jaws' reach twice
WIDER = to_rad(15.0)  # how far a jaw around the object is open beyond it [rad]; chosen, 20 mm
BESIDE = 0.002  # gap beside the taker's fixed pad [m]; chosen: it pushes nothing away
MOST = 12  # how many meetings are planned for before planning fails; chosen
AT_A_TIME = 5  # how many meetings are found before the best of them is planned for; chosen
SEEDS = 6  # how often meetings are searched, among other random configurations each time; chosen


def plan_handover(planner: Planner, request: HandoverRequest) -> Handover:
    """Plan to pass an object from gripper to gripper.

    Raises:
        ConfigError: There is no such arm or object, or giver and taker are the same.
        PlanningError: It cannot be taken, the arms cannot meet for it, or no motion was found.
    """
    return _Planning(planner, request).run()


class _Planning:
    """Plans one handover."""

    def __init__(self, planner: Planner, request: HandoverRequest) -> None:
        team = {each.name: each for each in request.team}
        for name in (request.giver, request.taker):
            if name not in team:
                known = ", ".join(sorted(team))
                raise ConfigError("handover", name, f"is no arm of this cell; there are: {known}")
        if request.giver == request.taker:
            raise ConfigError("handover", request.giver, "cannot pass anything to itself")
        self._planner, self._request, self._team = planner, request, team
        self._giver, self._taker = team[request.giver], team[request.taker]
        held = {each.name: each for each in self._giver.request.scene.attached}
        if request.thing not in held:
            known = ", ".join(sorted(held)) or "nothing"
            reason = f"is not in the hand of {request.giver}, which holds: {known}"
            raise ConfigError("thing", request.thing, reason)
        self._thing = held[request.thing]
        with self._giver.named():
            self._at_giver = planner.context(self._giver.request)
        with self._taker.named():
            self._at_taker = planner.context(self._taker.request)
        self._of_giver, self._of_taker = self._at_giver.model, self._at_taker.model
        self._jaw = JawGeometry(self._of_giver)
        self._q_jaw_free = min(self._giver.request.q_jaw + WIDER, self._jaw.opened)

    def run(self) -> Handover:
        """Plan the first meeting for which everything can be planned."""
        grasps = self._free_grasps()
        problem: So101Error | None = None
        tried = 0
        for meeting in self._meetings(grasps):
            grasp = grasps[meeting.which]
            ready = self._ready(meeting, grasp)
            if ready is None:
                continue
            try:
                return self._planned(meeting, grasp, ready)
            except PlanningError as error:
                problem, tried = error, tried + 1
                if tried == MOST:
                    break
        if problem is not None:
            raise problem
        raise NoPath(
            f"there is no pose in which {self._giver.name} can hand '{self._thing.name}' to"
            f" {self._taker.name}; hold it nearer to one end, or move the arms"
            f" at least {ROOM * 1e3:.0f} mm closer together",
            where="goal",
            blockers=(self._thing.name,),
        )

    def _free_grasps(self) -> list[Grasp]:
        """The grasps that keep off the gripper that holds the object; refused if there are none."""
        grasps = tuple(grasps_of(self._thing.shape))
        free, best = [], -np.inf
        giver = Hand(self._of_giver, self._q_jaw_free)
        hand = cache(lambda q_jaw: Hand(self._of_taker, q_jaw))
        for grasp in grasps:
            clearance = giver.clearance(hand(self._q_jaw_open(grasp)), self._T_giver_taker(grasp))
            best = max(best, clearance)
            if clearance >= ROOM:
                free.append(grasp)
        if not free:
            what = "is too thick to be taken"
            if grasps:
                what = (
                    f"is too small to be passed on: the hands would come within"
                    f" {max(best, 0.0) * 1e3:.0f} mm ({ROOM * 1e3:.0f} mm must stay free)"
                )
            raise NoPath(f"'{self._thing.name}' {what}", where="goal", blockers=(self._thing.name,))
        return free

    def _q_jaw_open(self, grasp: Grasp) -> float:
        return min(self._jaw.angle_for(grasp.thickness) + WIDER, self._jaw.opened)

    def _T_giver_taker(self, grasp: Grasp) -> SE3:
        """The pose of the taker's tool in the giver's tool frame."""
        T_tool_grip = self._jaw.T_tool_grip(grasp.thickness + 2.0 * BESIDE)
        return self._thing.T_tool_object @ grasp.T_object_grip @ T_tool_grip.inverse

    def _meetings(self, grasps: Sequence[Grasp]) -> Iterator[Meeting]:
        """Meetings, a few at a time, those first for which both arms move least."""
        T_giver_taker = self._giver.T_cell_base.inverse @ self._taker.T_cell_base
        meetings = Meetings(self._of_giver, self._of_taker, T_giver_taker)
        T_tools = [self._T_giver_taker(each) for each in grasps]
        q_giver, q_taker = self._giver.request.q_start, self._taker.request.q_start

        def turned(each: Meeting) -> float:
            return float(
                max(np.abs(each.q_giver - q_giver).max(), np.abs(each.q_taker - q_taker).max())
            )

        for round_ in range(SEEDS):
            seed = self._giver.request.seed + 2 * round_
            found = meetings.find(T_tools, seed)
            while some := list(islice(found, AT_A_TIME)):
                yield from sorted(some, key=turned)

    def _ready(self, meeting: Meeting, grasp: Grasp) -> Array | None:
        """The taker's configuration before it takes the object; None if nothing free is found."""
        q_jaw = self._q_jaw_open(grasp)
        giver, taker = self._giver, _with(self._taker, q_jaw=q_jaw)
        at_giver, at_taker = self._at_giver, self._at_taker
        around_taker = at_taker.moves.collision
        if not at_giver.is_free(meeting.q_giver):
            return None
        if not around_taker.is_free(meeting.q_taker, q_jaw):
            return None
        T_base_tool = self._of_taker.frame(meeting.q_taker)
        try:
            before = at_taker.ik.solve(_exactly(_back(T_base_tool)), meeting.q_taker).q
            at_giver.ik.solve(
                _exactly(_back(self._of_giver.frame(meeting.q_giver))), meeting.q_giver
            )
        except PlanningError:
            return None
        if not around_taker.is_free(before, q_jaw):
            return None
        passing = self._holding(giver)
        # The giver's jaw opens there, the taker's is open.
        jaws = np.array([[giver.request.q_jaw], [self._q_jaw_free]])
        opening = Course(t=0.0, dt=1.0, q=np.hstack([np.tile(meeting.q_giver, (2, 1)), jaws]))
        pairs = (
            (passing, opening, taker.resting(meeting.q_taker), taker.name),
            (giver, giver.resting(meeting.q_giver), taker.resting(before), None),
        )
        for mine, course, theirs, name in pairs:
            bodies = bodies_of(mine.request.scene.attached, name or "")
            T = mine.T_cell_base.inverse @ taker.T_cell_base
            empty = bodies_of(taker.request.scene.attached)
            if (
                first_meeting((bodies, course), (empty, theirs), T, since=0.0, early=0.0)
                is not None
            ):
                return None
        return np.asarray(before)

    def _planned(self, meeting: Meeting, grasp: Grasp, q_before: Array) -> Handover:
        """Plan all motions of one meeting."""
        planner, giver = self._planner, self._giver
        taker = _with(self._taker, q_jaw=self._q_jaw_open(grasp))
        goals = {giver.name: meeting.q_giver, taker.name: q_before}
        team = [
            _with(each, q_goal=goals.get(each.name, each.request.q_start))
            for each in (self._team | {taker.name: taker}).values()
        ]
        # The short motions first: they are what fails.
        T_base_tool = self._of_taker.frame(meeting.q_taker)
        taker = _with(taker, q_start=q_before)
        giving = self._holding(_with(giver, q_start=meeting.q_giver))
        still = [
            _with(each, q_start=each.request.q_start)
            for each in self._team.values()
            if each.name not in goals
        ]
        take = self._alone(taker, _line(T_base_tool), [giving, *still])
        T_cell_giver = giver.T_cell_base @ self._of_giver.frame(meeting.q_giver)
        T_giver_base = T_cell_giver.inverse @ taker.T_cell_base
        T_giver_taker = T_giver_base @ self._of_taker.frame(take.q_goal)
        taken = replace(
            self._thing,
            T_tool_object=T_giver_taker.inverse @ self._thing.T_tool_object,
            passed_to=giver.name,
        )
        holding = _with(taker, q_start=take.q_goal, q_jaw=self._q_jaw_closed(grasp))
        holding = _holding(holding, (*taker.request.scene.attached, taken))
        self._alone(holding, JointGoal(q=take.q_goal), [giving, *still])  # bears it
        free = _without(giving, self._thing.name)
        free = _with(free, q_jaw=self._q_jaw_free)
        back = _back(self._of_giver.frame(meeting.q_giver))
        leave = self._alone(free, _line(back), [holding, *still])
        self._check_left(_with(free, q_start=leave.q_goal), holding)
        approach = plan_together(planner, team)
        return Handover(
            giver=giver.name,
            taker=taker.name,
            thing=self._thing,
            taken=replace(taken, passed_to=""),
            approach=approach,
            take=take,
            leave=leave,
            q_jaw_open=taker.request.q_jaw,
            q_jaw_closed=self._q_jaw_closed(grasp),
            q_jaw_free=self._q_jaw_free,
        )

    def _q_jaw_closed(self, grasp: Grasp) -> float:
        return self._jaw.angle_for(grasp.thickness)

    def _holding(self, giver: TeamMember) -> TeamMember:
        """The giver, with the taker allowed to touch the object."""
        held = tuple(
            replace(each, passed_to=self._taker.name) if each.name == self._thing.name else each
            for each in giver.request.scene.attached
        )
        return _holding(giver, held)

    def _alone(
        self, mover: TeamMember, goal: JointGoal | LineGoal, others: Sequence[TeamMember]
    ) -> Plan:
        """A motion of one arm while the others stand where they start."""
        seen = tuple(each.seen_from(mover, each.resting(each.request.q_start)) for each in others)
        with mover.named():
            return self._planner.plan(replace(mover.request, goal=goal, others=seen))

    def _check_left(self, giver: TeamMember, taker: TeamMember) -> None:
        """Refuse (``NoPath``) if the giver is still near the object."""
        first, second = (
            (bodies_of(each.request.scene.attached, ""), each.resting(each.request.q_start))
            for each in (giver, taker)
        )
        T = giver.T_cell_base.inverse @ taker.T_cell_base
        met = first_meeting(first, second, T, since=0.0, early=0.0)
        if met is not None:
            raise NoPath(
                f"after letting go, {giver.name}'s {met.first} would be only"
                f" {met.distance * 1e3:.0f} mm from {taker.name}'s {met.second}; hold the object"
                " nearer to one end",
                where="goal",
                blockers=(met.second,),
            )


def _with(
    member: TeamMember,
    *,
    q_start: Array | None = None,
    q_goal: Array | None = None,
    q_jaw: float | None = None,
) -> TeamMember:
    request = member.request
    q_start = request.q_start if q_start is None else q_start
    request = replace(
        request,
        q_start=q_start,
        goal=JointGoal(q=q_start if q_goal is None else q_goal),
        q_jaw=request.q_jaw if q_jaw is None else q_jaw,
        others=(),
    )
    return replace(member, request=request)


def _holding(member: TeamMember, attached: tuple[Attached, ...]) -> TeamMember:
    scene = replace(member.request.scene, attached=attached)
    return replace(member, request=replace(member.request, scene=scene))


def _without(member: TeamMember, name: str) -> TeamMember:
    return _holding(
        member, tuple(each for each in member.request.scene.attached if each.name != name)
    )


def _back(T_base_tool: SE3) -> SE3:
    return T_base_tool @ SE3.from_translation((0.0, 0.0, -BEFORE))


def _exactly(T_base_tool: SE3) -> PoseGoal:
    return PoseGoal(T_base_tool=T_base_tool, metric=GoalMetric.FULL_POSE)


def _line(T_base_tool: SE3) -> LineGoal:
    return LineGoal(T_base_tool=T_base_tool, metric=GoalMetric.FULL_POSE)


class JawGeometry:
    """Where the gripper holds an object, and the jaw angle for its thickness.

    The frame ``jaw_tip`` is on the pad of the fixed jaw, which faces against that frame's x axis,
    towards the moving jaw. A held object lies on the pad, so its middle is half its thickness away.
    ``closed`` and ``opened`` are the smallest and the largest angle of the jaw [rad].
    """

    def __init__(self, model: RobotModel) -> None:
        lower, upper = model.pin_model.lowerPositionLimit, model.pin_model.upperPositionLimit
        self.closed, self.opened = float(lower[5]), float(upper[5])
        zero = np.zeros(5)
        T_base_tip = model.frame(zero, "jaw_tip")
        self._T_tool_tip = model.frame(zero).inverse @ T_base_tip
        p_tip_jaw = (
            T_base_tip.inverse @ model.link_placements(zero, 0.0)["moving_jaw_so101_v1_link"]
        ).p
        self._length = math.hypot(p_tip_jaw[0], p_tip_jaw[2])
        self._aside = math.atan2(-p_tip_jaw[0], -p_tip_jaw[2])

    def T_tool_grip(self, thickness: float) -> SE3:
        """The middle of a held object: z along the approach, x across the jaws."""
        return self._T_tool_tip @ SE3.from_translation((-0.5 * thickness, 0.0, 0.0))

    def angle_for(self, gap: float) -> float:
        """The jaw angle [rad] for a gap [m] between the pads at ``jaw_tip``; at most ``opened``."""
        sine = math.sin(self._aside) - gap / self._length
        opened = self._aside - math.asin(max(sine, -1.0))
        return min(self.closed + opened, self.opened)


class Hand:
    """The gripper and the jaw of an arm, in its tool frame, to keep off another arm's."""

    def __init__(self, model: RobotModel, q_jaw: float) -> None:
        zero = np.zeros(5)
        T_tool_base, links = model.frame(zero).inverse, model.link_placements(zero, q_jaw)
        self.parts = [
            (hull_of(each), T_tool_base @ links[each]) for each in (GRIPPER_LINK, JAW_LINK)
        ]

    def clearance(self, other: Hand, T_tool_other: SE3) -> float:
        """The distance to another arm's hand with its tool at ``T_tool_other`` [m]."""
        request = coal.DistanceRequest()
        return min(
            float(
                coal.distance(
                    a, placed(T), b, placed(T_tool_other @ T_b), request, coal.DistanceResult()
                )
            )
            for a, T in self.parts
            for b, T_b in other.parts
        )
