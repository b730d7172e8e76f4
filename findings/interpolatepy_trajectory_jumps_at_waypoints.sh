#!/bin/sh
# InterpolatePy 3.3.2: TrapezoidalTrajectory.interpolate_waypoints, limits of 2 rad/s and 5 rad/s2.
#
# Expected: a trajectory whose function reports speeds and accelerations within the limits moves within them.
# Seen: what it reports always is. But it chooses the speeds at waypoints itself, and where two of them lie too near to
# each other for those speeds, each segment is right by itself and they do not fit together: for 100 random paths of five
# waypoints the position jumps in about a quarter of them, by up to 72 mrad (4 deg) from one instant to the next, and the
# speed in a third. A servo that is sent these goals gets a blow; nothing is raised or warned of.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet InterpolatePy==3.3.2 "numpy<3"
"$folder/venv/bin/python" - <<'PY'
import numpy as np
from interpolatepy import InterpolationParams, TrapezoidalTrajectory

SPEED, ACCELERATION, STEPS = 2.0, 5.0, 2000
random, jumps, kicks, reported = np.random.default_rng(0), [], [], []
for _ in range(100):
    path = InterpolationParams(points=random.uniform(-2.0, 2.0, 5).tolist(), vmax=SPEED, amax=ACCELERATION)
    at, duration = TrapezoidalTrajectory.interpolate_waypoints(path)
    q, qd, qdd = np.array([at(t) for t in np.linspace(0.0, duration, STEPS + 1)]).T
    dt = duration / STEPS
    jumps.append(np.abs(np.diff(q)).max() - SPEED * dt)
    kicks.append(np.abs(np.diff(qd)).max() - ACCELERATION * dt)
    reported.append(max(np.abs(qd).max() / SPEED, np.abs(qdd).max() / ACCELERATION))
jumps, kicks = np.array(jumps), np.array(kicks)
print(f"reported: at most {max(reported):.3f} of the limits")
print(f"position jumps by more than 1 mrad in {(jumps > 1e-3).sum()} of 100, by up to {1e3 * jumps.max():.0f} mrad")
print(f"speed jumps by more than 0.05 rad/s in {(kicks > 0.05).sum()} of 100, by up to {kicks.max():.2f} rad/s")
assert max(reported) < 1.001
assert (jumps > 1e-3).sum() > 10 and jumps.max() > 0.03 and (kicks > 0.05).sum() > 15
PY
