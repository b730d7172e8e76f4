"""Keep joint angles with the calibration they were measured with, and convert them to another.

An angle counts from its joint's zero, and a new calibration may put that elsewhere. What a user
keeps (poses, programs, guided paths) therefore has the encoder position at each joint's zero. The
difference between two of them, for one arm, is what its angles change by. For two arms it means
nothing: their horns are mounted differently. So differences up to ``MOST`` are converted, and
larger ones refused. What was kept without zeros is used as it is.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from so101_motion.common.attributes import Attributes
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg

KEY = "encoder_zeros"  # the key of the zeros in a file

MOST = np.radians(10.0)
"""Largest difference of a zero that one arm's calibrations have [rad]: recordings of the travel
that go wrong and other conventions of zero make a few degrees; one tooth of a horn is 14.4 deg."""

_log = logging.getLogger(__name__)
_log.setLevel(logging.WARNING)  # a user is told, also where the rest of the log is switched off
_TURN = 4096  # [tick]


@dataclass(frozen=True, slots=True, kw_only=True)
class EncoderZero:
    """Where the zero of a joint is on its servo's encoder."""

    direction: int  # 1 if the encoder counts up with the angle, else -1
    # the encoder's position at angle zero, of the jaw where it is closed, 0 to below 4096 [tick];
    # to a tenth
    ticks: float


EncoderZeros = Mapping[str, EncoderZero]  # the zeros of an arm's joints, by joint


def zeros_to(zeros: EncoderZeros | None) -> dict[str, object]:
    """The entry of a file for the zeros of the arm's joints; empty if they are not all known."""
    if zeros is None or not all(joint in zeros for joint in ARM_JOINTS):
        return {}
    listed = {
        joint: {"direction": zeros[joint].direction, "ticks": zeros[joint].ticks}
        for joint in ARM_JOINTS
    }
    return {KEY: listed}


def zeros_from(content: Mapping[str, object]) -> EncoderZeros | None:
    """The zeros in the parsed JSON of a file; None if it has none."""
    given = content.get(KEY)
    if given is None:
        return None
    found = {}
    for joint in ARM_JOINTS:
        entry = given.get(joint) if isinstance(given, Mapping) else None
        if not isinstance(entry, Mapping) or entry.get("direction") not in (1, -1):
            reason = 'must be {"direction": 1 or -1, "ticks": ...}'
            raise ConfigError(f"{KEY}: {joint}", entry, reason)
        ticks = Attributes(entry, ("direction", "ticks"), kind="entry").number(
            "ticks", -1.0, lower=0.0, upper=float(_TURN), unit="ticks"
        )
        if ticks < 0.0:
            raise ConfigError(f"{KEY}: {joint}", entry, 'has no "ticks"')
        found[joint] = EncoderZero(direction=int(entry["direction"]), ticks=ticks)
    return found


def shift(
    made_with: EncoderZeros | None,
    now: EncoderZeros | None,
    *,
    what: str,
    file: Path,
    name: str = "",
) -> Array:
    """What to add to kept joint angles, so that the arm stands where it did, shape (5,), [rad].

    Args:
        made_with: The zeros when they were kept; None if not known.
        now: The zeros of the arm that is to move; None if not known, or if it is simulated.
        what: What was kept, for messages, such as ``'the pose "mug"'``.
        file: Its file.
        name: The entry of the file, if there may be others.

    Raises:
        ConfigError: The zeros are those of another arm, or a servo has been mounted anew.
    """
    if made_with is None or now is None or not all(joint in now for joint in ARM_JOINTS):
        return np.zeros(5)
    ticks = np.array([made_with[joint].ticks - now[joint].ticks for joint in ARM_JOINTS])
    ticks = (ticks + _TURN / 2) % _TURN - _TURN / 2
    directions = np.array([now[joint].direction for joint in ARM_JOINTS])
    turned = [joint for joint in ARM_JOINTS if made_with[joint].direction != now[joint].direction]
    angles = np.asarray(directions * ticks * (2.0 * np.pi / _TURN))
    if not turned and not ticks.any():
        return np.zeros(5)
    differs = ", ".join(
        f"{joint} {'turns the other way' if joint in turned else f'{angle_deg:+.1f} deg'}"
        for joint, angle_deg in zip(ARM_JOINTS, to_deg(angles), strict=True)
        if joint in turned or abs(angle_deg) >= 0.05
    )
    if turned or np.any(np.abs(angles) > MOST):
        raise ConfigError(
            what,
            str(file),
            f"was made with another calibration, whose zeros differ too much for the same arm:"
            f" {differs}. Record it again on this arm, or use its angles as they are:"
            f' so101 calibration accept "{file}"' + (f' --name "{name}"' if name else ""),
        )
    _log.warning("%s was made with another calibration; converted: %s", what, differs)
    return angles
