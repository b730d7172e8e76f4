#!/bin/sh
# proxsuite 0.8.0: ProxQP of a program with a linear cost, which has next to no quadratic part; as it comes (eps_abs 1e-5).
#
# Expected: "PROXQP_SOLVED" means the minimum, up to about 1e-5.
# Seen: it stops short of a bound, with residuals below 1e-6 and the status "solved". By itself it checks that the gradient is
# balanced, and counts the bound's multiplier in although x is not at the bound; whether that fits (the duality gap) is only
# checked with check_duality_gap=True. Six joints that shall be as fast as they may, 1.5 rad/s, get 1.45; with the cost
# times two, which is the same program, 1.40. quadprog gives the bound each time.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet proxsuite==0.8.0 quadprog==0.1.13
"$folder/venv/bin/python" - <<'PY'
import numpy as np
import quadprog
from proxsuite import proxqp

H, FASTEST = 1e-6 * np.eye(6), 1.5


def solve(factor, check):
    program = proxqp.dense.QP(6, 0, 0, True)
    bound = np.full(6, FASTEST)
    program.settings.check_duality_gap = check
    program.init(H, np.full(6, -factor), None, None, None, None, None, -bound, bound)
    program.solve()
    assert program.results.info.status == proxqp.PROXQP_SOLVED
    return program.results


sides = np.hstack([np.eye(6), -np.eye(6)])
for factor in (0.1, 1.0, 2.0):
    found, checked = solve(factor, False), solve(factor, True)
    exact = quadprog.solve_qp(H, np.full(6, factor), sides, np.full(12, -FASTEST))[0]
    print(
        f"cost {factor}: {found.x.max():.4f} rad/s, residuals {found.info.pri_res:.0e} and {found.info.dua_res:.0e}, duality gap"
        f" {found.info.duality_gap:.2f}; gap checked {checked.x.max():.4f}; quadprog {exact.max():.4f}"
    )
    assert np.allclose(exact, FASTEST, atol=1e-6) and np.allclose(checked.x, FASTEST, atol=1e-3)
    short = FASTEST - found.x
    assert found.info.pri_res < 1e-5 and found.info.dua_res < 1e-5 and np.all(short > 0.004)
PY
