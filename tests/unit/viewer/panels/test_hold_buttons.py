"""What the bar says of several arms."""

from types import SimpleNamespace

import numpy as np
from so101_viewer.page.bar import Bar
from so101_viewer.panels.hold_buttons import HoldButtons

from so101_motion.common.modes import Mode
from so101_motion.common.state import JointReading, JointState
from so101_motion.rig.protocols import ArmConnection


def rig(mode):
    state = JointState(
        t=0.0,
        mode=mode,
        reading=JointReading(q=np.zeros(5), qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0),
        q_ref=np.zeros(5),
        qd_ref=np.zeros(5),
        q_jaw_ref=0.0,
        arm_moving=False,
        jaw_moving=False,
        late_ticks=0,
        fault=None,
    )
    return SimpleNamespace(connection=ArmConnection(to="a port"), arm=SimpleNamespace(state=state))


def said(**modes):
    """The alerts about arms in these modes."""
    bar = Bar()
    context = SimpleNamespace(bar=bar, button=lambda *_args, **_named: None)
    HoldButtons(
        context,
        title="Two arms",
        rigs={name: rig(mode) for name, mode in modes.items()},
        guide=lambda: None,
        fade=lambda *_: None,
    ).refresh()
    return [each.text for sentences in bar._alerts.values() for each in sentences]


def test_what_is_true_of_several_arms_is_said_once():
    by_hand = "You can move the arm by hand. Press Hold to keep it where it is."
    assert said(left=Mode.GUIDING, right=Mode.GUIDING) == [f"left, right: {by_hand}"]
    first, second = said(left=Mode.LIMP, right=Mode.GUIDING)
    assert first.startswith("left: The arm is limp.")
    assert second == f"right: {by_hand}"
    assert said(only=Mode.GUIDING) == [by_hand]
