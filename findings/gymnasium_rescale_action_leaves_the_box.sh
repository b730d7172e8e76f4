#!/bin/sh
# gymnasium 1.4.0 beside 0.29.1: RescaleAction(env, -1, 1), the wrapper between a policy's -1..1 and joint angles or per cent.
#
# Expected: an environment behind it only gets actions that are in its action_space: an action of 1.5 is refused, as it was,
# or cut.
# Seen: 0.29.1 refuses it (AssertionError). 1.4.0 extrapolates: a joint that may be sent -1.5 to 0.5 rad is sent 1.0,
# a gripper of 0 to 100 % is sent -50; no error, no warning, and the environment's own action_space does not contain it.
# The usual remedy, ClipAction around the environment and RescaleAction around that, is refused as "unbounded"; ClipAction has
# to be outermost.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/sent.py" <<'PY'
import sys

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.wrappers import ClipAction, RescaleAction


class Arm(gymnasium.Env):
    action_space = Box(np.array([-1.5, 0.0], np.float32), np.array([0.5, 100.0], np.float32))
    observation_space = Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.sent = action
        return np.zeros(1, np.float32), 0.0, False, False, {}


def sent(wrap):
    arm = Arm()
    try:
        wrapped = wrap(arm)
        wrapped.reset()
        wrapped.step(np.array([1.5, -2.0], np.float32))
    except (AssertionError, ValueError) as error:
        return type(error).__name__
    return f"{[round(float(each), 3) for each in arm.sent]}, in its box: {arm.action_space.contains(arm.sent)}"


version = gymnasium.__version__
plain = sent(lambda arm: RescaleAction(arm, -1.0, 1.0))
inside = sent(lambda arm: RescaleAction(ClipAction(arm), -1.0, 1.0))
outside = sent(lambda arm: ClipAction(RescaleAction(arm, -1.0, 1.0)))
print(f"gymnasium {version}: RescaleAction {plain}; around ClipAction {inside}; inside ClipAction {outside}")
assert version == sys.argv[1] and outside == "[0.5, 0.0], in its box: True"
assert plain == {"0.29.1": "AssertionError", "1.4.0": "[1.0, -50.0], in its box: False"}[version]
assert version == "0.29.1" or inside == "ValueError"
PY
for version in 0.29.1 1.4.0; do
    python3 -m venv "$folder/$version"
    "$folder/$version/bin/pip" install --quiet "gymnasium==$version" "numpy<2.3"
    "$folder/$version/bin/python" -W ignore "$folder/sent.py" "$version"
done
