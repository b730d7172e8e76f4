import numpy as np
import pytest
import qpsolvers
from scipy import sparse

from benchmarks.bench_servo import as_problem
from so101_motion.planning.differential.servo_qp import ROWS, WORTH, ServoQp


def a_program(rng: np.random.Generator):
    """Jacobian, wish, bounds that hold zero, rows that zero keeps."""
    J = np.vstack([0.2 * rng.normal(size=(3, 5)), rng.normal(size=(3, 5))])
    wish = rng.normal(size=5) * rng.choice([0.01, 0.3, 2.0])
    lower, upper = -rng.uniform(0.0, 1.0, 5), rng.uniform(0.0, 1.0, 5)
    rows = rng.integers(0, ROWS + 1)
    return J, wish, lower, upper, 0.2 * rng.normal(size=(rows, 5)), -rng.uniform(0.0, 0.1, rows)


def cost(program, qd: np.ndarray, share: float) -> float:
    P, q, *_ = as_problem(*program)
    x = np.append(qd / np.abs(program[1]).max(), share)
    return float(0.5 * x @ P @ x + q @ x)


@pytest.mark.filterwarnings("ignore:The default value of raise_error")  # qpsolvers' call of OSQP
@pytest.mark.parametrize("seed", range(8))
def test_it_solves_the_program_as_qpsolvers_does_with_osqp(seed: int) -> None:
    rng, qp = np.random.default_rng(seed), ServoQp()
    for _ in range(20):
        program = a_program(rng)
        P, q, G, h, lb, ub = as_problem(*program)
        exact = qpsolvers.solve_qp(
            sparse.csc_matrix(P),
            q,
            sparse.csc_matrix(G) if len(G) else None,
            h if len(G) else None,
            lb=lb,
            ub=ub,
            solver="osqp",
            eps_abs=1e-9,
            eps_rel=1e-9,
            max_iter=100000,
        )
        qd, share = qp.solve(*program)
        size = np.abs(program[1]).max()
        assert np.all((qd >= program[2]) & (qd <= program[3]))
        assert 0.0 <= share <= 1.0
        assert np.all(program[4] @ qd >= program[5] - 5e-3 * size)
        assert cost(program, qd, share) == pytest.approx(
            cost(program, size * exact[:5], exact[5]), abs=1e-2 * WORTH
        )


def test_a_wish_that_fits_is_granted() -> None:
    J = np.vstack([0.2 * np.eye(3, 5), np.eye(3, 5)])
    wish = np.array([0.1, 0.2, -0.3, 0.1, 0.0])
    wide = np.ones(5)
    qd, share = ServoQp().solve(J, wish, -wide, wide, np.zeros((0, 5)), np.zeros(0))
    assert qd == pytest.approx(wish, abs=1e-3)
    assert share == pytest.approx(1.0, abs=1e-3)


def test_a_joint_that_gives_only_half_slows_all() -> None:
    J = np.vstack([0.2 * np.eye(3, 5), np.zeros((3, 5))])
    wish = np.array([0.4, 0.4, 0.4, 0.0, 0.0])
    upper = np.array([0.2, 1.0, 1.0, 1.0, 1.0])
    qd, share = ServoQp().solve(J, wish, -np.ones(5), upper, np.zeros((0, 5)), np.zeros(0))
    assert share == pytest.approx(0.5, abs=0.04)
    assert qd[1:] == pytest.approx(0.5 * wish[1:], abs=0.02)
    assert qd[0] <= upper[0]
