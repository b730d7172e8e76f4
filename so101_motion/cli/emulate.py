"""``so101 emulate``: emulate the servos of an arm behind a virtual serial port."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import click

from so101_motion.cli.options import flag, option, verb
from so101_motion.cli.param_types import SCENE, Finite, OutFile
from so101_motion.cli.shared import aside
from so101_motion.common import interrupts

if TYPE_CHECKING:
    from so101_motion.planning.collision.scene import Scene


@verb()
def emulate(
    link: Path | None = option("Make a link to the port with this name.", OutFile(link=True)),
    ids: str = option("Servo ids on the bus: 1-6, 1-3,5, 6=1.", default="1-6"),
    new: bool = flag("A new kit: all servos have id 1, none is plugged in."),
    realtime: bool = flag("Send bytes at the speed of a real bus."),
    latency: float = option(
        "How long the adapter delays replies.", Finite(min=0.0), 0.0, metavar="S"
    ),
    loss: float = option("Share of replies that get lost.", Finite(0.0, 1.0), 0.0, metavar="P"),
    corrupt: float = option(
        "Share of replies with a flipped bit.", Finite(0.0, 1.0), 0.0, metavar="P"
    ),
    spread: float = option(
        "Servos differ by up to this share in friction, play, gain, dead time and zero.",
        Finite(0.0, 0.5),
        0.0,
        metavar="S",
    ),
    seed: int = option("With --spread: another seed, another arm.", int, 0, metavar="N"),
    like: Path | None = option(
        "Servos as so101 identify found them: the file beside the calibration.",
        click.Path(path_type=Path),
        metavar="FILE",
    ),
    volts: str = option(
        "Servos of this kind, at their rated supply: fitted on a pendulum, or on an arm.",
        click.Choice(["12", "7.4"]),
        "12",
    ),
    scene: Scene | None = SCENE,
    faults: tuple[str, ...] = option(
        "Such as dead:3 or unplug@4+2; repeatable.", name="--fault", multiple=True
    ),
    goal_torque: bool = option(
        "Whether a goal switches torque on. Firmware 3.10 does; one report says it does not.",
        default=True,
        name="--goal-torque/--no-goal-torque",
    ),
    hand: TextIO | None = option(
        "A script that moves limp joints by hand.",
        click.File(encoding="utf-8", errors="replace"),
    ),
) -> None:
    """Emulate the servos of an arm behind a virtual serial port, until Ctrl-C.

    Prints the port. Any program that talks to STS3215 servos can open it. The arm lies folded and
    limp. While it runs you can type faults, such as "hot:gripper=68" or "unplug+3", and what
    people do to an arm: "only:gripper" plugs in this servo alone, "chain" plugs in all, "pose"
    lets a hand hold the arm up, "sweep" lets it move each joint to its stops. "end sweep" or "end
    hot:gripper" ends it; "help" tells what can be typed. With
    --scene it says what happens to the items; "take:cube" takes one away.

    \b
    so101 emulate --link /tmp/so101          then: so101 move --port /tmp/so101 --pose ready
    so101 emulate --new --link /tmp/so101    then: so101 setup --port /tmp/so101
    so101 emulate --like my-arm.servos.json
    """  # noqa: D301
    from so101_motion.calib.record import servo_file
    from so101_motion.common.named_poses import POSES
    from so101_motion.drivers.emulator import emulator, pty_port, run
    from so101_motion.drivers.emulator import faults as fault_names
    from so101_motion.drivers.servo_types import STS3215_7V4, STS3215_12V
    from so101_motion.planning.kinematics.model import RobotModel
    from so101_motion.rig.things import things_in

    twin = None if like is None else servo_file.read_file(like)
    folded = next(pose.q for pose in POSES if pose.name == "rest")
    nobody_holds_it = hand is None and not new
    options = emulator.EmulatorOptions(
        link=link,
        ids=dict.fromkeys(range(1, 7), 1) if new else emulator.parse_ids(ids),
        loose=new,
        calibrated=not new,
        q_start=(*folded.tolist(), 0.0) if nobody_holds_it else (0.0,) * 6,
        spread=spread,
        seed=seed,
        kind=STS3215_7V4 if volts == "7.4" else STS3215_12V,
        figures={} if twin is None else twin.servos,
        goal_enables_torque=goal_torque,
        pacing=pty_port.Pacing(realtime=realtime, latency=latency),
        wire=fault_names.WireFaults(loss=loss, corrupt=corrupt),
        faults=tuple(fault_names.parse_fault(text) for text in faults),
        hand=hand.read() if hand is not None else "",
    )
    if sys.stdin is not None and sys.stdin.isatty():
        aside("help lists the faults and actions that can be typed; Ctrl-C ends this")
    run.run_emulator(
        options,
        announce=click.echo,
        stop=threading.Event(),
        commands=sys.stdin,
        gravity=RobotModel.load().gravity_torque,
        things=None if scene is None else things_in(scene),
    )
    if interrupts.first():
        raise interrupts.ToldInterrupt("the virtual port is closed")
