#!/bin/sh
# ruckig 0.19.4: InputParameter.enabled, two joints with limits of 1 rad/s, 2 rad/s2 and 10 rad/s3; the second one is disabled
# while it moves with 0.3 rad/s and accelerates with 1 rad/s2.
#
# Expected: a joint that is disabled is left out: it stays where it is, comes to rest, or has no numbers.
# Seen: it runs on, with the acceleration that it had at that moment, for as long as anybody asks: 2.0 rad/s at the end of the
# other joint's motion, twice its max_velocity, and 2 rad further, away from its target. update() returns Finished for
# that state, and position_extrema say 0 to 0 for the joint. Enabled, the same joint keeps its limits and arrives.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ruckig==0.19.4
"$folder/venv/bin/python" - <<'PY'
from ruckig import InputParameter, OutputParameter, Result, Ruckig

FASTEST, START, TARGET = 1.0, 0.5, 0.6
seen = {}
for enabled in (True, False):
    planner, asked, answer = Ruckig(2, 0.01), InputParameter(2), OutputParameter(2)
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = [FASTEST] * 2, [2.0] * 2, [10.0] * 2
    asked.current_position, asked.current_velocity, asked.current_acceleration = [0.0, START], [0.0, 0.3], [0.0, 1.0]
    asked.target_position = [1.0, TARGET]
    asked.enabled = [True, enabled]
    fastest, result = 0.0, Result.Working
    while result == Result.Working:
        result = planner.update(asked, answer)
        answer.pass_to_input(asked)
        fastest = max(fastest, abs(answer.new_velocity[1]))
    extrema = answer.trajectory.position_extrema[1]
    seen[enabled] = (result, answer.new_position[1], fastest, (extrema.min, extrema.max))
    print(
        f"second joint {'enabled' if enabled else 'disabled'}: {result.name} at {answer.new_position[1]:.3f} rad, up to"
        f" {fastest:.2f} rad/s; position_extrema {extrema.min:.2f} to {extrema.max:.2f}"
    )
result, end, fastest, _ = seen[True]
assert result == Result.Finished and abs(end - TARGET) < 1e-6 and fastest < FASTEST + 1e-6
result, end, fastest, extrema = seen[False]
assert result == Result.Finished and end > START + 1.5 and fastest > 1.8 * FASTEST and extrema == (0.0, 0.0)
PY
