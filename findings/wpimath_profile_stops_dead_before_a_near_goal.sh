#!/bin/sh
# robotpy-wpimath 2026.2.2: TrapezoidProfile, used as its documentation recommends: in each cycle calculate(dt) from the
# reference before, with a goal that may change at any time. Limits of 1 rad/s and 2 rad/s2.
#
# Expected: when the goal comes nearer than the joint can stop, the reference goes past it and returns, within the limits.
# Seen: it does that for a goal behind the joint. For one in front, but too near, the speed that it started with is replaced by
# the one from which it could still stop: from 1 rad/s to rest in 0.05 rad it slows by up to 24 rad/s2, twelve times what
# is allowed, and the position is not the integral of the speed. calculate(0), the state now, is already another state. A
# leader arm whose goal is retargeted while it moves meets this whenever its hand slows down.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet robotpy-wpimath==2026.2.2
"$folder/venv/bin/python" - <<'PY'
from wpimath.trajectory import TrapezoidProfile

DT, FASTEST, HARDEST = 0.02, 1.0, 2.0
profile = TrapezoidProfile(TrapezoidProfile.Constraints(FASTEST, HARDEST))
seen = {}
for position in (-0.2, 0.25, 0.1, 0.05):
    goal = TrapezoidProfile.State(position, 0.0)
    state = TrapezoidProfile.State(0.0, 1.0)
    now = profile.calculate(0.0, state, goal)
    hardest = off = 0.0
    for _ in range(150):
        following = profile.calculate(DT, state, goal)
        hardest = max(hardest, abs(following.velocity - state.velocity) / DT)
        off = max(off, abs((following.position - state.position) / DT - (following.velocity + state.velocity) / 2.0))
        state = following
    seen[position] = hardest
    print(
        f"goal {position:+.2f} rad: calculate(0) is at {now.position:+.4f} rad with {now.velocity:.3f} rad/s, slows by up"
        f" to {hardest:.1f} rad/s2; position and speed disagree by {off:.2f} rad/s; ends at {state.position:+.3f} rad"
    )
assert max(seen[-0.2], seen[0.25]) < HARDEST + 1e-6
assert seen[0.1] > 5.0 * HARDEST and seen[0.05] > 10.0 * HARDEST
near = profile.calculate(0.0, TrapezoidProfile.State(0.0, 1.0), TrapezoidProfile.State(0.1, 0.0))
assert near.velocity < 0.7 and near.position < -0.01
PY
