"""Pick and place as one operation: for the terminal, the page, DoCommands and other machines.

Lengths are millimetres here. A place is text: ``"200,120,0"``, the middle of the item's underside,
with a fourth number for how far it is turned from how it was picked, in degrees; or the name of
what it is put on.
"""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from so101_motion.arm.picking import DOING, TRIES, Picker, PickRun
from so101_motion.common.errors import ConfigError, Interrupted, NotPossibleNow, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.operation import Input, LocalOperation, Offer, Picture, Row, Started, View
from so101_motion.common.units import to_deg, to_m, to_mm, to_rad
from so101_motion.planning.collision.coal_shapes import held_shape
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.collision.shape_files import read_shape
from so101_motion.planning.picking.grasps import Wishes
from so101_motion.planning.picking.pick_plan import PickPlan, Place

PICKED = ("list_items", "plan_pick", "pick", "place")
"""The commands that are DoCommands of an arm as well."""

NO_ITEM = "There is no item yet: on the World tab add a box, and give it a mass."

_MOST_POINTS = 200  # of the drawn line

_FROM = {"": ("above", "side"), "above": ("above",), "side": ("side",)}


def place_from(text: str, scene: Scene) -> Place | None:
    """The place that a text means; None if it is empty, ``ConfigError`` if it means none.

    The name of something in ``scene`` means the middle of its top, as far as that is known: of the
    box around it.
    """
    if not text:
        return None
    for each in scene.obstacles:
        if each.name == text and not each.keep_out:
            T = each.T_base_obstacle
            corners = held_shape(read_shape(each.shape))[1] @ T.R.T + T.p
            low, high = corners.min(axis=0), corners.max(axis=0)
            return Place(p=np.append(0.5 * (low + high)[:2], high[2]))
    try:
        numbers = [float(each) for each in text.split(",")]
        if len(numbers) not in (3, 4):
            raise ValueError(text)
    except ValueError:
        reason = 'must be "x,y,z" in mm, "x,y,z,turn" with degrees, or the name of an obstacle'
        raise ConfigError("place", text, reason) from None
    yaw = to_rad(numbers[3]) if len(numbers) == 4 else None
    return Place(p=to_m(np.array(numbers[:3])), yaw=yaw)


class _Planned(NamedTuple):
    """What was planned, and for what."""

    item: str
    place: str
    wishes: Wishes
    plan: PickPlan
    scene: Scene  # the arm's scene when it was planned


class PickOperation(LocalOperation):
    """Picks the items of an arm's scene and places them; ``place`` is proposed."""

    refuses = False

    def __init__(self, picker: Picker, place: str = "") -> None:
        super().__init__()
        self._picker = picker
        self._planned: _Planned | None = None
        self._item, self._at = "", place
        self._run: PickRun | None = None
        self._trouble = ""
        self.commands = {
            "list_items": self._list_items,
            "plan_pick": self._plan_pick,
            "pick": self._pick,
            "place": self._place,
            "run": self._go,
            "stop": self._stop,
        }

    @property
    def view(self) -> View:
        run, planned = self._run, self._planned
        plan = run.plan if run is not None else planned.plan if planned else None
        moving = run is not None and not run.future.done()
        state = run.stage if moving and run else "planned" if planned else "idle"
        return View(
            state=state,
            text=self._text(moving, run, planned),
            rows=_rows(plan, run, moving),
            trouble="" if moving else self._trouble,
            offers=self._offers(moving),
            said=self.said,
            picture=_picture(plan) if plan is not None and (moving or planned) else None,
            facts={"items": self._items, "held": self._held},
        )

    @property
    def _items(self) -> list[str]:
        return [each.name for each in self._picker.arm.scene.items]

    @property
    def _held(self) -> list[str]:
        return [each.name for each in self._picker.arm.scene.attached if not each.fixed]

    def _text(self, moving: bool, run: PickRun | None, planned: _Planned | None) -> str:
        if moving and run is not None:
            return f"{DOING[run.stage].format(run.name)}."
        if planned is not None:
            return f"Planned: {planned.plan.duration:.1f} s. Press Go."
        if self._held:
            return f"The gripper holds {self._held[-1]}; say where to put it."
        if not self._items:
            return NO_ITEM
        around = self._picker.arm.scene.obstacles
        tops = [each.name for each in around if each.mass is None and not each.keep_out]
        places = " or ".join((*tops[:3], "x,y,z in mm"))
        return f"Choose an item and where to put it: {places}. Without a place it is held."

    def _offers(self, moving: bool) -> tuple[Offer, ...]:
        if moving:
            return (Offer(command="stop", title="Stop", key="s", cancels=True),)
        mode = self._picker.arm.state.mode
        busy = None if mode is Mode.HOLDING else f"the arm is {mode.words}"
        names = tuple(self._held or self._items)
        nothing = None if names else "there is no item"
        chosen = self._item if self._item in names else (*names, "")[0]
        given = {"item": chosen, "place": self._at}
        inputs = {
            "item": Input(label="Item", choices=names),
            "place": Input(label="Place"),
        }
        why_not, title = busy or nothing, "Pick and place"
        at_once = Offer(
            command="pick", title=title, arguments=given, inputs=inputs, key="n", why_not=why_not
        )
        if self._held:
            at_once = replace(
                at_once,
                command="place",
                title="Place",
                arguments={"item": chosen, "at": self._at},
                inputs={"item": inputs["item"], "at": inputs["place"]},
            )
        return (
            Offer(command="plan_pick", title="Plan", arguments=given, inputs=inputs, key="p",
                  why_not=why_not),
            Offer(command="run", title="Go", why_not=busy or self._unplanned, key="g"),
            at_once,
        )  # fmt: skip

    @property
    def _unplanned(self) -> str | None:
        """Why nothing that is planned can be carried out."""
        if self._planned is None:
            return "plan it first"
        same = self._planned.scene is self._picker.arm.scene
        return None if same else "the scene has changed since it was planned; plan it again"

    # Commands

    def _list_items(self) -> dict[str, Any]:
        return {
            "items": [
                {
                    "name": each.name,
                    "mass_kg": each.mass,
                    "position_mm": to_mm(each.T_base_obstacle.p).round(1).tolist(),
                }
                for each in self._picker.arm.scene.items
            ],
            "held": self._held,
        }

    def _plan_pick(self, item: str, place: str = "", approach: str = "") -> dict[str, Any]:
        """Plan to pick an item, or to place what is held; moves nothing."""
        self._item, self._at, self._planned, self._run = item, place, None, None
        self._trouble = ""
        scene, wishes = self._picker.arm.scene, _wishes(approach)
        plan = self._picker.plan(item, self._place_from(place), wishes)
        self._planned = _Planned(item, place, wishes, plan, scene)
        return _facts(plan)

    def _pick(
        self, item: str, place: str = "", approach: str = "", tries: int | None = TRIES
    ) -> Started:
        """Pick an item, and place it if ``place`` says where."""
        if item in self._held:
            raise ConfigError("item", item, "is in the gripper already; place it")
        return self._begin(item, place, _wishes(approach), max(tries or TRIES, 1))

    def _place(self, item: str, at: str) -> Started:
        if item not in self._held:
            raise ConfigError("item", item, "is not in the gripper; pick it first")
        if not at:
            raise ConfigError("at", at, 'is missing; "x,y,z" in mm')
        return self._begin(item, at, Wishes(), 1)

    def _place_from(self, text: str) -> Place | None:
        return place_from(text, self._picker.arm.scene)

    def _go(self, tries: int | None = TRIES) -> Started:
        """Carry out what was planned; if the jaws miss, further grasps as they were wished."""
        planned, why_not = self._planned, self._unplanned
        if planned is None or why_not:
            raise NotPossibleNow("run", why_not or "plan it first")
        tries = max(tries or TRIES, 1)
        return self._begin(planned.item, planned.place, planned.wishes, tries, planned.plan)

    def _stop(self) -> dict[str, Any]:
        if self._run is not None:
            self._run.stop()
        return {}

    def _begin(
        self, item: str, place: str, wishes: Wishes, tries: int, plan: PickPlan | None = None
    ) -> Started:
        self._item, self._at, self._planned, self._trouble = item, place, None, ""
        run = self._run = self._picker.start(
            item, self._place_from(place), wishes, tries=tries, planned=plan, tell=self.say
        )
        run.future.add_done_callback(self._ended)

        def answer() -> dict[str, Any]:
            assert run.plan is not None
            return {**_facts(run.plan), "held": self._held}

        return Started(run.future, run.motion.interrupt, answer)

    def _ended(self, done: Future[None]) -> None:
        error = done.exception()
        if isinstance(error, So101Error) and not isinstance(error, Interrupted):
            self._trouble = str(error)
            self.say(self._trouble, "bad")


def _wishes(approach: str) -> Wishes:
    if approach not in _FROM:
        raise ConfigError("approach", approach, 'must be "above", "side", or left out for either')
    return Wishes(kinds=_FROM[approach])  # type: ignore[arg-type]  # of these words


def _facts(plan: PickPlan) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "item": plan.item,
        "duration_s": round(plan.duration, 3),
        "stages_s": {name: round(each.duration, 3) for name, each in plan.plans.items()},
    }
    if plan.grasp is not None:
        facts |= {
            "approach": plan.grasp.kind,
            "tilt_deg": round(float(to_deg(plan.grasp.tilt)), 1),
            "thickness_mm": round(float(to_mm(plan.grasp.thickness)), 1),
        }
    return facts


def _rows(plan: PickPlan | None, run: PickRun | None, moving: bool) -> tuple[Row, ...]:
    if plan is None:
        return ()
    order = list(DOING)
    reached = order.index(run.stage) if run is not None else -1
    if run is not None and not moving and run.future.exception() is None:
        reached = len(order)
    return tuple(
        Row(
            label=name,
            cells=(f"{plan.plans[name].duration:.1f} s",),
            mark="✓" if k < reached else "•" if k == reached else "",
            tone="good" if k < reached else "busy" if k == reached and moving else "dim",
        )
        for k, name in enumerate(order)
        if name in plan.plans
    )


def _picture(plan: PickPlan) -> Picture:
    """The tool's path through all stages, and the arm at the end of each as a ghost."""
    ghosts = [(*each.q_goal.tolist(), plan.q_jaw(name)) for name, each in plan.plans.items()]
    line = np.concatenate([each.tool_path for each in plan.plans.values()])
    line = line[:: max(1, len(line) // _MOST_POINTS)]
    return Picture(ghosts=tuple(ghosts), line=tuple(map(tuple, line.round(4).tolist())))
