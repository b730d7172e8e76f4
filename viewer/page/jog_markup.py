"""The buttons of the Jog tab as HTML; ``server/front/jog.js`` handles them."""

from __future__ import annotations

from html import escape

from so101_motion.common.state import ARM_JOINTS

from .jogging import ARROWS, JOINTS

_JOINT_ROWS = tuple(
    (i, joint.replace("_", " "), keys)
    for i, (joint, keys) in enumerate(zip(ARM_JOINTS, ("aq", "sw", "de", "fr", "gt"), strict=True))
)
_TOOL_ROWS = (
    (0, "X", "sw"),
    (1, "Y", "da"),
    (2, "Z", "fr"),
    (3, "turn about X", "ju"),
    (4, "turn about Y", "ki"),
    (5, "turn about Z", "lo"),
)
_JAW_ROW = (6, "gripper", "hy")


def jog_buttons(mode: str, speed: str, *, hand: str, is_on: bool) -> str:
    """Two buttons a row, less and more, with their keys.

    Args:
        mode: What is moved; its button above is lit.
        speed: The step of the speed; its button is lit too.
        hand: The id of the widget that receives what is held.
        is_on: Whether they can be used.
    """
    moved = _JOINT_ROWS if mode == JOINTS else () if mode == ARROWS else _TOOL_ROWS
    rows = "".join(_row(*row, is_on=is_on) for row in (*moved, _JAW_ROW))
    kind = "drag" if mode == ARROWS else "hold"
    on = "on" if is_on else "off"
    return (
        f'<div class="so101-jog" data-hand="{escape(hand)}" data-jog="{on}" data-kind="{kind}"'
        f' data-chosen="{escape(mode)} {escape(speed)}">{rows}</div>'
    )


def _row(axis: int, name: str, keys: str, *, is_on: bool) -> str:
    less, more = keys[0], keys[1]
    words = ("close", "open") if axis == _JAW_ROW[0] else ("less", "more")
    return (
        _button(axis, -1, "−", less, f"{name}, {words[0]}", is_on=is_on)
        + f"<span>{escape(name)}</span>"
        + _button(axis, 1, "+", more, f"{name}, {words[1]}", is_on=is_on)
    )


def _button(axis: int, way: int, sign: str, key: str, name: str, *, is_on: bool) -> str:
    return (
        f'<button type="button" data-axis="{axis}" data-way="{way}" data-key="{key}"'
        f' aria-label="{escape(name)}"{"" if is_on else " disabled"}>'
        f"{sign} <kbd>{key.upper()}</kbd></button>"
    )
