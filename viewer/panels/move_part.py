"""Connect the model of the arms with the scene, their panels and the Move tab."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import viser

from so101_motion.arm.cell import Cell
from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT, JointState
from so101_motion.common.units import to_deg
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.request import Plan
from so101_motion.rig.protocols import RigLike

from ..page import markup
from ..page.bar import add_stop
from ..page.page_context import Drawn, PageContext, Part
from ..page.target_ik import TargetSolver
from ..scene.camera_and_lights import Sight, set_up_view, view_buttons
from ..scene.reach_view import ReachView
from ..scene.scene_view import hit
from ..view_model import MoveModel, ViewModel
from .plan_panel import SELECTS, PlanPanel
from .poses import PoseList
from .stage import Stage

_WIDTH = 290
_KEYS = "Space or Esc stops, P plans."

_WORDS_EVERY = 3  # figures are updated every so many pictures of a motion; nobody reads 30 a second


class ArmPanel:
    """The joint angles of an arm, in a tab that is named after it."""

    def __init__(self, gui: viser.GuiApi, panel: viser.PanelHandle, name: str = "Arm") -> None:
        with panel.add_tab(name, viser.Icon.ROBOT):
            self._joints = gui.add_html("")
            gui.add_html(markup.small(_KEYS))

    def show(self, state: JointState, bounds: tuple[Array, Array], *, is_lost: bool) -> None:
        """Show the joints between their limits, shapes (5,), [rad]; all dim if the arm is lost."""
        angles = zip(ARM_JOINTS, to_deg(state.q), *map(to_deg, bounds), strict=True)
        silent = set(state.reading.angles) if is_lost else state.reading.silent
        joints = [
            markup.gauge(name, *map(float, each), is_old=name in silent) for name, *each in angles
        ]
        opened = 100.0 * (state.q_jaw - JAW_CLOSED) / (JAW_OPEN - JAW_CLOSED)
        jaw = markup.gauge(
            "gripper", opened, 0.0, 100.0, unit="%", warns=False, is_old=GRIPPER_JOINT in silent
        )
        html = "".join((*joints, jaw))
        self._joints.content = f'<div class="so101-gauges">{html}</div>'


class MovePart(Part):
    """The part of the page that shows and moves the arms; the name of a single one is empty.

    Args:
        cell: Keeps several arms apart; None for a single one.
        bases: Where their bases stand, by name.
        stops: What Stop calls, each in a thread of its own.
        plan: A plan of a single arm that is shown from the start.

    Attributes:
        pages: Target and picture of each arm, by name.
        nodes: The node in the scene that stands where an arm's base does, by the arm's name.
    """

    def __init__(
        self,
        context: PageContext,
        rigs: Mapping[str, RigLike],
        cell: Cell | None,
        bases: Mapping[str, SE3],
        *,
        title: str,
        stops: tuple[Callable[[], None], ...],
        plan: Plan | None = None,
    ) -> None:
        now, submit = next(iter(rigs.values())).clock.now, context.in_background
        self.pages = {
            name: ViewModel(
                arm=rig.arm,
                gripper=rig.gripper,
                load_solver=TargetSolver,
                submit=submit,
                now=now,
            )
            for name, rig in rigs.items()
        }
        self._context, self._first = context, next(iter(self.pages.values()))
        self._arm = next(iter(rigs.values())).arm
        of_each = "" if cell is None else " of each arm"
        welcome = f"{title}. Drag the arrows{of_each}, then press Plan."
        self.model = MoveModel(cell, self.pages, submit=submit, now=now, welcome=welcome)
        if plan is not None:
            self.model.show(plan)
        self._set_up_scene(bases, is_one=cell is None)
        self.stop_button = add_stop(context.gui, *stops)
        self.panel = context.gui.add_panel()
        self.panel.dock_left()
        self.panel.set_width(_WIDTH)
        self._rigs = dict(rigs)
        self._joints = {name: ArmPanel(context.gui, self.panel, name or "Arm") for name in rigs}
        poses = None
        if cell is None:
            (rig,) = rigs.values()
            poses = PoseList(SavedPoses(zeros=lambda: rig.connection.encoder_zeros), self.model)
        self._words = PlanPanel(context, self.model, poses, on_click=self._set_click)
        context.bar.plan = self._words.plan_button
        context.bar.stop = self.stop_button
        self._pictures = 0
        self._drawn = Drawn.PLAN

    def _set_up_scene(self, bases: Mapping[str, SE3], *, is_one: bool) -> None:
        context, sight = self._context, Sight.of_arms(tuple(bases.values()))
        set_up_view(context.server, sight)
        robot = RobotModel.load()
        context.bar.views = view_buttons(context.server, sight)
        context.leave_open(*(button for _, button in context.bar.views))
        self.nodes = {name: "" if is_one else f"/arms/{k}" for k, name in enumerate(self.pages)}
        self.stages = {}
        for name, page in self.pages.items():
            if not is_one:
                T, node = bases[name], self.nodes[name]
                context.server.scene.add_frame(
                    node, show_axes=False, position=T.p, wxyz=T.quaternion_wxyz()
                )
                context.server.scene.add_label(f"{node}/name", name, position=(-0.08, 0.0, 0.0))
            self.stages[name] = Stage(
                context,
                page,
                model=robot,
                reach=ReachView(context.server.scene, robot) if is_one else None,
                on_click=self._clicked,
                root=self.nodes[name],
            )

    def _set_click(self, does: str) -> None:
        for stage in self.stages.values():
            stage.set_clickable(does != SELECTS)

    def _clicked(self, p_from: Array, along: Array) -> None:
        met = hit(self._arm.scene, p_from, along)
        if met is not None:
            self._first.set_target_above(met)

    def set_visible(self, visible: bool) -> None:
        for stage in self.stages.values():
            stage.set_visible(visible)

    def set_handles(self, shown: bool) -> None:
        for stage in self.stages.values():
            stage.set_handles(shown)

    def refresh(self) -> bool:
        is_other = self._context.front.drawn is not self._drawn
        return self.model.refresh() or is_other

    def show(self) -> None:
        self._pictures += 1
        self._drawn = self._context.front.drawn
        for stage in self.stages.values():
            stage.show()
        moves = any(each.state.arm_moving for each in self.pages.values())
        if not moves or self._pictures % _WORDS_EVERY == 0:
            for name, each in self.pages.items():
                is_lost = self._rigs[name].connection.problem is not None
                self._joints[name].show(each.state, each.arm.range, is_lost=is_lost)
            self._words.show()
