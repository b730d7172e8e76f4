"""``so101 sweep check``: check motions or a program after scene or calibration have changed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from so101_motion.cli.dataset import read_calibration


def check_motions(
    run: Callable[..., None],
    folder: Path,
    scene_file: Path | None,
    calibration_file: Path | None,
    taught_file: Path | None,
) -> None:
    """Check the motions in a folder that ``so101 sweep plans`` made."""
    from so101_motion.tasks.sweeps import CheckSweep, as_lerobot, check_summary

    if taught_file is not None:
        raise click.UsageError("--taught-with is for programs; motions have LeRobot's units")
    calibration = read_calibration(calibration_file)
    reading = None if calibration is None else as_lerobot(calibration)

    def summary(out: Path) -> dict[str, object]:
        figures, failed = check_summary(out)
        return {**figures, "numbers of those blocked": " ".join(map(str, failed)) or "none"}

    run(CheckSweep.of(folder, _scene(scene_file), reading), summary)


def check_program(
    run: Callable[..., None],
    name: str,
    scene_file: Path | None,
    calibration_file: Path | None,
    taught_file: Path | None,
) -> None:
    """Check a program."""
    from so101_motion.tasks.program import files
    from so101_motion.tasks.sweeps import (
        ProgramCheckSweep,
        program_check_summary,
        program_text,
        since,
    )

    if (calibration_file is None) != (taught_file is None):
        raise click.UsageError(
            "a program has the joint angles of the calibration it was taught with; give both"
            " --taught-with and --calibration"
        )
    taught, now = read_calibration(taught_file), read_calibration(calibration_file)
    reading = None if taught is None or now is None else since(taught, now)
    program = files.read(files.find(name))

    def summary(out: Path) -> dict[str, object]:
        figures, failed = program_check_summary(out, program)
        return {**figures, **failed}

    sweep = ProgramCheckSweep(
        program=program_text(program), scene=_scene(scene_file), reading=reading
    )
    run(sweep, summary)


def _scene(file: Path | None) -> str:
    from so101_motion.files.scene_file import read_scene
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.tasks.sweeps import scene_text

    return scene_text(Scene() if file is None else read_scene(file))
