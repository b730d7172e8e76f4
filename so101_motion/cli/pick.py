"""``so101 pick``: pick an item of the scene, and put it somewhere."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import click

from so101_motion.cli.options import JSON, YES, argument, flag, option, verb
from so101_motion.cli.param_types import SCENE
from so101_motion.cli.shared import (
    answer,
    aside,
    busy_message,
    print_json,
    quietly,
    stops_on_ctrl_c,
)
from so101_motion.cli.sources import ANY_SOURCE, AnySource, ending, paced

if TYPE_CHECKING:
    from so101_motion.common.operation import Operation
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.rig.protocols import RigLike


@verb()
def pick(
    item: str = argument(),
    source: AnySource = ending(paced(ANY_SOURCE)),
    place: str = option(
        "Where to put it: middle of its underside [mm], and how far to turn it [deg]; or on what.",
        str,
        "",
        show_default=False,
        metavar="X,Y,Z[,TURN]|NAME",
    ),
    approach: str = option("Approach it from there only.", click.Choice(["above", "side"])),
    tries: int = option("Grasps that are tried.", click.IntRange(1, 20), 3),
    scene: Scene | None = SCENE,
    only_plan: bool = flag("Plan all stages and show them; nothing moves.", name="--plan"),
    yes: bool = YES,
    as_json: bool = JSON,
) -> None:
    """Pick ITEM of the scene; with --place put it there, else hold it.

    An item is an obstacle with "mass_kg" in the scene. What the gripper holds already is only
    placed. All stages are planned before the first one moves; Ctrl-C stops the arm, and what is
    held stays held.

    \b
    so101 pick cube --sim --scene examples/cube.json --place tray
    so101 pick cube --port /dev/ttyACM0 --scene table.json --plan
    """  # noqa: D301
    from so101_motion.tasks.picking import place_from

    if scene is not None:
        place_from(place, scene)  # refuses what is no place before the arm is opened
    opened = source.open_to_look() if only_plan else source.open()
    with quietly(), closing(opened) as rig:
        if scene is not None:
            rig.arm.scene = scene
        operation = _picking(rig)
        wish = {} if approach is None else {"approach": approach}
        with busy_message("planning"), closing(operation):
            found = operation.ask("plan_pick", item=item, place=place, **wish)
            if only_plan or not as_json:
                _show(found, as_json and only_plan)
            if only_plan:
                return
            question = f"Move the {source.what} for {found['duration_s']:.1f} s?"
            source.have_agreed(rig, question, yes)
            with stops_on_ctrl_c(rig.arm):
                done = operation.ask("run", tries=tries)
        for said in operation.view.said:
            aside(said.text)
        text = f"'{item}' is put down" if place else f"'{item}' is held"
        answer(as_json, "pick", {"source": source.what, **found, **done}, text)


def _picking(rig: RigLike) -> Operation:
    from so101_motion.rig.rig import Rig
    from so101_motion.tasks.picking import PickOperation

    if isinstance(rig, Rig):
        return PickOperation(rig.picker)
    from so101_motion.viam.client import MachineRig

    assert isinstance(rig, MachineRig)
    return rig.operation("picking", ("pick", "place", "run"))


def _show(found: Any, as_json: bool) -> None:
    if as_json:
        print_json("pick", {**found, "moved": False})
        return
    for name, seconds in found["stages_s"].items():
        click.echo(f"{name:<10}{seconds:6.1f} s")
    if "approach" in found:
        click.echo(
            f"from {found['approach']}, tilted {found['tilt_deg']:.0f} deg,"
            f" {found['thickness_mm']:.1f} mm between the jaws"
        )
