"""``so101 teleop``: make one arm follow another that is guided by hand."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from so101_motion.cli.options import JSON, START, flag, option, verb
from so101_motion.cli.param_types import PER_JOINT, PORT, SCENE, SECONDS, Finite, OutFile
from so101_motion.cli.shared import STOPPED, aside, have_agreed, print_json
from so101_motion.cli.sources import AT_END, Source, end_as_asked
from so101_motion.common import interrupts
from so101_motion.common.modes import HELD, Mode
from so101_motion.common.state import ARM_JOINTS

if TYPE_CHECKING:
    from so101_motion.common.clock import Clock
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.rig.rig import Rig
    from so101_motion.tasks.teleop import Recorder, Status

_EVERY = 0.2  # [s] between two prints of the state


@verb()
def teleop(
    leader: str = option('Serial port of the arm that leads, or "sim".', PORT, required=True),
    follower: str = option(
        'Serial port of the arm that follows, or "sim" for the simulated one.', PORT, required=True
    ),
    leader_calibration: Path | None = option("Calibration file.", click.Path(path_type=Path)),
    follower_calibration: Path | None = option("Calibration file.", click.Path(path_type=Path)),
    no_gripper: bool = flag("Leave the follower's jaw alone."),
    scale: object = option("Multiply the leader's angles by this; a minus reverses.", PER_JOINT),
    mirror: bool = flag("For arms that face each other: reverse pan and roll."),
    offsets: object = option("Add these five angles to the leader's [deg].", PER_JOINT),
    guard: bool = option(
        "Keep the follower clear of itself and the table.", default=True, name="--guard/--no-guard"
    ),
    scene: Scene | None = SCENE,
    speed: float | None = option(
        "Joint speed cap while it mirrors.  [default: 180]", float, metavar="DEG/S"
    ),
    acceleration: float | None = option(
        "Joint acceleration cap while it mirrors.  [default: 500]", float, metavar="DEG/S2"
    ),
    approach_speed: float | None = option(
        "Joint speed cap while it approaches the leader.  [default: 30]", float, metavar="DEG/S"
    ),
    record: Path | None = option(
        "Record it to this file, .csv or .mcap.", OutFile(".csv", ".mcap")
    ),
    fps: float = option("Rows a second.", Finite(0.1, 1000.0), 100.0),
    seconds: float | None = option("Stop after this time.", SECONDS),
    at_end: str = AT_END,
    yes: bool = START,
    as_json: bool = JSON,
) -> None:
    """Guide one arm by hand and let another follow. Ctrl-C ends it; then both arms hold.

    --at-end is for the follower.

    The leader goes limp, so have a hand on it. The follower moves slowly to the leader's pose, and
    mirrors it once it is within 5 deg. If either arm stops answering, the follower holds until you
    move the leader back to the follower's pose.

    \b
    so101 teleop --leader /dev/ttyACM0 --follower /dev/ttyACM1
    so101 teleop --leader /dev/ttyACM0 --follower sim --record first.csv --fps 30
    """  # noqa: D301
    from so101_motion.drivers.port.port_list import device_of
    from so101_motion.files.trajectory_export import mcap_writer
    from so101_motion.tasks.teleop import LocalArm, LocalFollower, LocalLeader, Teleop
    from so101_motion.tasks.teleop.config import read_how
    from so101_motion.tasks.teleop.leading import view_of

    how = {
        "scale": scale,
        "offsets_deg": offsets,
        "mirror": mirror,
        "speed_degs_per_sec": speed,
        "acceleration_degs_per_sec_per_sec": acceleration,
        "approach_speed_degs_per_sec": approach_speed,
    }
    turned, pace = read_how(how)
    if follower != "sim" and device_of(leader) == device_of(follower):
        raise click.UsageError("--leader and --follower must be two arms")
    if scene is not None and not guard:
        raise click.UsageError("--scene is only for the guard; leave out --no-guard")
    if record is not None and record.suffix.lower() == ".mcap":
        mcap_writer(record)  # fails now rather than when a hand is on the arm
    with ExitStack() as stack:
        leading = stack.enter_context(_open(leader, leader_calibration))
        following = stack.enter_context(_open(follower, follower_calibration))
        if scene is not None:
            following.arm.scene = scene
        have_agreed("The leader goes limp now. Are you holding it?", yes)
        end_as_asked(at_end, following)
        leads, follows = (
            LocalArm(station=rig, jaw=None if no_gripper else rig) for rig in (leading, following)
        )
        session = stack.enter_context(
            Teleop(
                LocalLeader(leads),
                LocalFollower(follows, guarded=guard),
                following.clock,
                mirror=turned,
                pace=pace,
            )
        )
        session.start(_recorder(record, fps, following))
        _watch(session, following.clock, seconds, lambda: view_of(session.status.to_json()).text)
        last = session.status
        session.stop()
        if as_json:
            print_json("teleop", _facts(last, record))
        elif record is not None:
            aside(f"saved {record}")
        if interrupts.first() and last.is_running:
            return  # the end of every verb tells how a signal leaves the arms
        print_end(last, leading.arm.state.mode, following.arm.state.mode)


def _open(port: str, calibration: Path | None) -> Rig:
    return Source(port=None if port == "sim" else port, calibration_file=calibration).open()


def _recorder(record: Path | None, fps: float, rig: Rig) -> Recorder | None:
    from so101_motion.tasks.teleop import Recorder
    from so101_motion.tasks.teleop.sides import middles_of

    if record is None:
        return None
    clock: Clock = rig.clock
    return Recorder(record, epoch=time.time() - clock.now(), middles=middles_of(rig), fps=fps)


def _watch(session: Any, clock: Clock, seconds: float | None, text: Callable[[], str]) -> None:
    """Show the state until Ctrl-C, a stop of the follower, or the time limit."""
    end = None if seconds is None else clock.now() + seconds
    shown = ""
    try:
        while session.status.is_running and (end is None or clock.now() < end):
            words = text()
            if words != shown:
                aside(words)
                shown = words
            time.sleep(_EVERY if end is None else min(_EVERY, max(end - clock.now(), 0.0)))
    except KeyboardInterrupt:
        interrupts.taken()


def print_end(last: Status, leader: Mode, follower: Mode) -> None:
    """Print that it has ended; if it ended by itself, print why and exit with ``STOPPED``."""
    if not last.is_running:
        aside(f"ended: {last.reason}")
        raise SystemExit(STOPPED)
    told = []
    for side, mode in (("leader", leader), ("follower", follower)):
        if mode is Mode.FAULT:  # such as a port that went away: its servos may hold or not
            told.append(f"the {side} is in a fault")
        elif mode not in HELD:
            told.append(f"the {side} is not held")
    aside(f"ended: {'; '.join(told) or 'both arms hold'}")


def _facts(status: Status, record: Path | None) -> dict[str, object]:
    return {
        "joints": list(ARM_JOINTS),
        "ended_as": status.phase.value,
        "reason": status.reason,
        "cycles": status.cycles,
        "last_error": status.last_error,
        "recorded_rows": status.recorded or 0,
        "record": str(record) if record is not None else None,
    }
