"""``so101 guide``: record a path while the arm is guided by hand, and replay it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from so101_motion.cli.options import JSON, START, YES, argument, flag, option, verb
from so101_motion.cli.param_types import IN_FILE, SECONDS, Finite, OutFile
from so101_motion.cli.shared import (
    STOPPED,
    Verbs,
    answer,
    aside,
    have_agreed,
    print_json,
    quietly,
    stops_on_ctrl_c,
)
from so101_motion.cli.sources import SOURCE, Source, ending, paced
from so101_motion.common import interrupts
from so101_motion.common.units import to_deg, to_rad

if TYPE_CHECKING:
    from so101_motion.cli.terminal import Terminal
    from so101_motion.rig.rig import Rig
    from so101_motion.tasks.guided import GuidedPath, PathRecorder, Replay

_OPEN, _CLOSED = 1.0, 0.0


@click.group(cls=Verbs)
def guide() -> None:
    """Guide the arm by hand, record its path, and replay it."""


@verb(guide)
def record(
    file: Path = argument(OutFile(".json")),
    source: Source = SOURCE,
    seconds: float | None = option("Stop after this time.", SECONDS),
    replace: bool = flag("Replace FILE if it is there."),
    yes: bool = START,
    as_json: bool = JSON,
) -> None:
    """Guide the arm by hand and record its path in FILE (.json).

    The arm carries its own weight and stays where you leave it. The keys o and c open and close the
    jaw; Enter or Ctrl-C ends and saves the recording. Then the arm holds.

    \b
    so101 guide record --port /dev/ttyACM0 wave.json
    """  # noqa: D301
    from so101_motion.cli.terminal import Terminal
    from so101_motion.tasks.guided import PathRecorder, files
    from so101_motion.tasks.teleop.sides import jaw_of

    files.refuse_taken(file, replace=replace)
    with quietly(), source.open() as rig:
        have_agreed("The arm will yield to your hand now. Are you holding it?", yes)
        rig.arm.set_manual(True)
        recorder = PathRecorder(rig.executor, jaw_of(rig))
        try:
            with Terminal() as terminal:
                _run_keys(terminal, rig, recorder, seconds)
        finally:
            path = recorder.end()
            files.write(path, file, replace=replace, zeros=rig.connection.encoder_zeros)
        if not recorder.ended_by:
            rig.arm.set_manual(False)
    if recorder.ended_by:
        aside(f"ended: {recorder.ended_by}")
    if as_json:
        print_json("guide-record", {"file": str(file), **_facts(path)})
    else:
        aside(f"saved {file}: {_in_words(path)}")
    if recorder.ended_by:
        raise SystemExit(STOPPED)


def _run_keys(terminal: Terminal, rig: Rig, recorder: PathRecorder, seconds: float | None) -> None:
    """Move the jaw with the keys until Enter, Ctrl-C, the time limit, or the end of manual mode."""
    from rich.text import Text

    from so101_motion.cli.terminal import ENTER, Quit, keys_line

    begin = rig.clock.now()
    try:
        terminal.mention("move the arm by hand; Ctrl-C ends it")
        while not recorder.future.done():
            now = rig.clock.now() - begin
            if seconds is not None and now >= seconds:
                return
            q = " ".join(f"{angle:6.1f}" for angle in to_deg(rig.arm.state.q))
            terminal.show(
                Text(f"recording {now:6.1f} s, {recorder.points} points at {q} deg"),
                keys_line(o="open the jaw", c="close it", Enter="done"),
            )
            key = terminal.key(0.1)
            if key == ENTER:
                return
            if key in ("o", "c"):
                if key == "o":
                    rig.gripper.move(_OPEN, wait=False)
                else:
                    rig.gripper.grab(_CLOSED, wait=False)
    except KeyboardInterrupt:
        interrupts.taken()
    except Quit:
        pass


@verb(guide)
def replay(
    file: Path = argument(IN_FILE),
    source: Source = ending(paced(SOURCE)),
    tolerance: float = option(
        "How far a joint may be from the path.", Finite(), 2.0, metavar="DEG"
    ),
    no_gripper: bool = flag("Leave the jaw alone."),
    times: int = option("Number of rounds.", click.IntRange(1, 1000), 1),
    yes: bool = YES,
    as_json: bool = JSON,
) -> None:
    """Move to the start of the path in FILE and along it, as fast as the caps allow.

    The motion is planned and checked for collisions before anything moves. Ctrl-C stops the arm.

    \b
    so101 guide replay --port /dev/ttyACM0 wave.json
    so101 guide replay --sim wave.json --speed 60 --yes
    """  # noqa: D301
    from so101_motion.tasks.guided import files, plan_replay, start_replay
    from so101_motion.tasks.teleop.sides import jaw_of

    files.read(file)  # refuses a wrong file before the arm is opened
    with quietly(), source.open() as rig:
        path = files.read(file, rig.connection.encoder_zeros)
        gripper = None if no_gripper else jaw_of(rig)
        for number in range(times):
            found = plan_replay(rig.arm, path, gripper=gripper, tolerance=to_rad(tolerance))
            if number == 0 and not as_json:
                aside(f"{file}: {_in_words(path)}, recorded")
                aside(_planned(found))
            source.have_agreed(rig, f"Move the {source.what}?", yes or number > 0)
            with stops_on_ctrl_c(rig.arm):
                start_replay(rig.arm, gripper, found).result()
        off_deg = float(to_deg(abs(rig.arm.state.q - found.plans[-1].q_goal).max()))
        facts = {"file": str(file), **_facts(path), "replay_s": found.duration}
        facts |= {"times": times, "off_deg": off_deg}
        text = f"arrived: joints within {off_deg:.2f} deg of the path's end"
        answer(as_json, "guide-replay", facts, text)


def _in_words(path: GuidedPath) -> str:
    jaw = "" if path.aperture is None else ", with the jaw"
    return f"{path.duration:.1f} s, {len(path)} points{jaw}"


def _planned(found: Replay) -> str:
    approach = found.approach.duration
    return (
        f"{approach:.1f} s to its start, then {found.duration - approach:.1f} s along it,"
        f" within {to_deg(found.tolerance):g} deg of the recording"
    )


def _facts(path: GuidedPath) -> dict[str, object]:
    return {"points": len(path), "duration_s": path.duration, "has_jaw": path.aperture is not None}
