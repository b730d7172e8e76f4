"""Where the ghost stands for a target: inverse kinematics while the arrows are dragged.

The same rules as the planner's (nearest solution that touches nothing), without a path. So the
ghost shows where a plan would end, or why there will be none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from so101_motion.errors import Unreachable
from so101_motion.geometry import SE3, Array, frozen_array
from so101_motion.planning.collision import CollisionModel
from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.ik import IkSolution, IkSolver
from so101_motion.planning.model import RobotModel
from so101_motion.planning.scene import Scene
from so101_motion.units import to_mm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aim:
    """A target and what becomes of the arm there.

    Attributes:
        goal: What to plan for.
        p_base: The target point in the base frame, shape (3,), [m].
        q: Joint angles of the ghost, shape (5,), [rad]: at the target, or as near as it gets.
        problem: Why the target cannot be had, as a sentence; None when it can.
    """

    goal: PoseGoal | JointGoal
    p_base: Array
    q: Array
    problem: str | None

    def __post_init__(self) -> None:
        object.__setattr__(self, "p_base", frozen_array(self.p_base, (3,)))
        object.__setattr__(self, "q", frozen_array(self.q, (5,)))


class Aimer:
    """Turns targets into aims.

    Args:
        tool_point: Where the tool is for joint angles (5,); shape (3,), [m].
        candidates: All solutions for a goal, nearest to the given angles first.
        contact: Which two bodies touch for joint angles and jaw angle, or None.
    """

    def __init__(
        self,
        *,
        tool_point: Callable[[Array], Array],
        candidates: Callable[[PoseGoal, Array], Iterable[IkSolution]],
        contact: Callable[[Array, float], tuple[str, str] | None],
    ) -> None:
        self.tool_point = tool_point
        self._candidates = candidates
        self._contact = contact

    @classmethod
    def load(cls, *, scene: Scene) -> Aimer:
        """One for the SO-101 with what is around it and in its hand."""
        model = RobotModel.load()
        collisions = CollisionModel(model, scene)
        return cls(
            tool_point=lambda q: model.frame(q).p,
            candidates=IkSolver(model).candidates,
            contact=collisions.first_contact,
        )

    def at_point(self, p_base: Array, *, q_seed: Array, q_jaw: float) -> Aim:
        """Aim at a point.

        Args:
            p_base: The point in the base frame, shape (3,), [m].
            q_seed: Where the arm is, shape (5,), [rad]; the ghost stays as near as it can.
            q_jaw: Jaw angle [rad].
        """
        goal = PoseGoal(T_base_tool=SE3.from_translation(p_base))
        q_first: Array | None = None
        touching = ("", "")
        try:
            for solution in self._candidates(goal, q_seed):
                contact = self._contact(solution.q, q_jaw)
                if contact is None:
                    return Aim(goal=goal, p_base=p_base, q=solution.q, problem=None)
                if q_first is None:
                    q_first, touching = solution.q, contact
        except Unreachable as error:
            return Aim(goal=goal, p_base=p_base, q=error.q_nearest, problem=_out_of_reach(error))
        q = q_seed if q_first is None else q_first
        return Aim(goal=goal, p_base=p_base, q=q, problem=_collides(touching))

    def at_joints(self, q: Array, *, q_jaw: float) -> Aim:
        """Aim at joint angles ``q``, shape (5,), [rad], with the jaw at ``q_jaw`` [rad]."""
        contact = self._contact(q, q_jaw)
        return Aim(
            goal=JointGoal(q=q),
            p_base=self.tool_point(q),
            q=q,
            problem=None if contact is None else _collides(contact),
        )


def _out_of_reach(error: Unreachable) -> str:
    distance = f"Out of reach by {max(to_mm(error.error_position), 1.0):.0f} mm"
    return f"{distance}: {error.limit}." if error.limit else f"{distance}."


def _collides(pair: tuple[str, str]) -> str:
    return f"Collides there: {pair[0]} with {pair[1]}."
