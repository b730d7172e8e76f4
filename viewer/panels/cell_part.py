"""Connect the model of several arms with the scene, their panels and the Move tab they share."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import viser

from so101_motion.common.errors import So101Error
from so101_motion.common.geometry import Array
from so101_motion.files.cell_file import CellFile
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.cell_rigs import CellRigs

from ..cell_model import CellModel, CellScreen, CommonPlan
from ..page import markup, texts
from ..page.front_tab import Drawn
from ..page.guiding import Guiding
from ..page.page_context import PageContext
from ..page.part import Part
from ..page.screen_state import Tone
from ..page.stop_button import add_stop
from ..page.target_ik import TargetSolver
from ..scene.camera_and_lights import Sight, Views, set_up_view
from ..scene.stage import Stage
from ..view_model import ViewModel
from .arm_panel import ArmPanel, docked_left
from .cell_plots import CellPlots
from .plan_controls import PlanControls
from .plan_panel import plots_panel
from .target_controls import TargetControls

_WORDS_EVERY = 3
"""Figures are updated every so many pictures of a motion; nobody reads 30 a second."""


class CellPart(Part):
    """The part of the page that shows and moves several arms.

    Args:
        cell: The arms.
        file: Where they stand.
        stops: What Stop calls, each in a thread of its own.

    Attributes:
        model: What is shown.
        stop_button: What the bar's Stop presses.
        panel: The panel on the left.
        nodes: The node in the scene that stands where an arm's base does, by the arm's name.
    """

    def __init__(
        self,
        context: PageContext,
        cell: CellRigs,
        file: CellFile,
        *,
        title: str,
        stops: tuple[Callable[[], None], ...],
    ) -> None:
        rigs = cell.rigs
        clock = next(iter(rigs.values())).clock
        self.model = CellModel(
            cell.cell,
            {
                name: ViewModel(
                    arm=rig.arm,
                    gripper=rig.gripper,
                    load_solver=TargetSolver.load,
                    submit=context.in_background,
                    now=clock.now,
                    welcome="",
                )
                for name, rig in rigs.items()
            },
            submit=context.in_background,
            now=clock.now,
            welcome=f"{title}. Drag the arrows of each arm, then press Plan.",
        )
        self._context = context.reporting(self.model.report)
        self._bases = {each.name: each.T_cell_base for each in file.arms}
        self.nodes = {name: f"/arms/{k}" for k, name in enumerate(rigs)}
        self._set_up_view()
        self._robot = RobotModel.load()
        self._stages = {name: self._stage(name, arm) for name, arm in self.model.arms.items()}
        self.stop_button = add_stop(context.gui, *stops)
        self.panel = docked_left(context.gui)
        self._joints = {name: ArmPanel(context.gui, self.panel, name) for name in rigs}
        self._targets = {
            name: TargetControls(self._context, arm) for name, arm in self.model.arms.items()
        }
        self._plan = PlanControls(self._context, self.model)
        self._add_tab(context.gui)
        self._plots_panel = plots_panel(context.gui)
        self._plots = CellPlots(context.gui, self._plots_panel, tuple(rigs))
        context.bar.stop, context.bar.plan = self.stop_button, self._plan.plan_button
        self._guiding = [Guiding(rig.arm, clock, context.in_background) for rig in rigs.values()]
        self._shown: CommonPlan | None = None
        self._pictures = 0
        self._drawn = Drawn.PLAN

    def _set_up_view(self) -> None:
        context, sight = self._context, Sight.of_arms(tuple(self._bases.values()))
        set_up_view(context.server, sight)
        context.bar.views = Views(context.server, sight, follows=False).buttons
        context.leave_open(*(button for _, button in context.bar.views))

    def _stage(self, name: str, arm: ViewModel) -> Stage:
        scene, T, node = self._context.server.scene, self._bases[name], self.nodes[name]
        scene.add_frame(node, show_axes=False, position=T.p, wxyz=T.quaternion_wxyz())
        scene.add_label(f"{node}/name", name, position=(-0.08, 0.0, 0.0))
        stage: Stage

        def dragged(p_base: Array) -> None:
            stage.dragged_to(p_base)
            arm.set_target_point(p_base)

        stage = Stage(
            self._context,
            model=self._robot,
            on_drag=dragged,
            on_turn=arm.set_turn,
            on_release=lambda: None,
            root=node,
        )
        return stage

    def _add_tab(self, gui: viser.GuiApi) -> None:
        with self._context.tabs.add_tab("Move"):
            self._sentence = gui.add_html("")
            self._plan.add_buttons()  # first, so that they are seen on a phone without scrolling
            arms = gui.add_tab_group()
            for name, target in self._targets.items():
                with arms.add_tab(name):
                    target.add_target()
                    target.add_jaw()
                    with gui.add_folder("More", expand_by_default=False):
                        target.add_choices()
            self._plan.add_timeline()
            self._facts = gui.add_html("")
            self._plan.add_caps()

    def guide(self) -> None:
        """Start hand guiding of all arms for a limited time. Hold and Stop end it as well."""
        for each in self._guiding:
            each.start()

    def set_handles(self, shown: bool) -> None:
        """Show the targets' arrows, or hide each until its target changes."""
        for stage in self._stages.values():
            stage.set_handles(shown)

    def fade(self, name: str, faded: bool) -> None:
        """Show an arm in grey, or in its own colours."""
        self._stages[name].fade(faded)

    def mark(self, name: str, joints: Mapping[str, Tone]) -> None:
        """Colour the links that these joints of an arm move, each in the tone of its alarm."""
        self._stages[name].mark(joints)

    def refresh(self) -> bool:
        """Take in the states of the arms, the plan being made and the running motions."""
        for each in self._guiding:
            try:
                each.refresh()
            except So101Error as error:
                self.model.report(error)
        is_other = self._context.front.drawn is not self._drawn
        return self.model.refresh() or is_other

    def show(self) -> None:
        """Draw the arms; update their figures now and then."""
        screen, self._drawn = self.model.screen(), self._context.front.drawn
        self._pictures += 1
        for name, each in screen.arms.items():
            self._stages[name].show(each)
        moves = any(each.state.arm_moving for each in screen.arms.values())
        if not moves or self._pictures % _WORDS_EVERY == 0:
            self._show_words(screen)

    def _show_words(self, screen: CellScreen) -> None:
        self._sentence.content = markup.sentence(screen.sentence)
        for name, each in screen.arms.items():
            self._joints[name].show(each.state, each.range)
            self._targets[name].show(each)
        plan = screen.plan
        if plan is not None and plan is not self._shown:
            if self._shown is None:
                self._plots_panel.expand()
            self._shown = plan
            self._plots.show(plan)
            self._plan.set_duration(plan.duration)
        self._plots.name(plan, is_current=screen.plan_is_current)
        self._plan.show(screen, self._plots.uuids)
        self._facts.content = markup.facts(plan_facts(plan if screen.plan_is_current else None))


def plan_facts(plan: CommonPlan | None) -> tuple[tuple[str, str], ...]:
    """The figures of a plan for all arms: duration, who waits for whom, clearances."""
    if plan is None:
        return (("Duration", "–"),)
    pairs = (texts.between(each.first, each.second, each.least) for each in plan.clearances)
    others = [(name, each.report.for_others) for name, each in plan.plans.items()]
    return (("Duration", f"{plan.duration:.2f} s"), *(each for each in others if each[1]), *pairs)
