"""A hundred thousand image ellipses at once, by both routes of the closed form, and one by one."""

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from planeopt import equations as eq
from planeopt.closed_form import solve_both
from worked_example import SETUP

N = 100_000
ROUTES = {"outside the beam (primal)": SETUP, "near the beam (dual)": eq.Setup(25.0, 6.0, 8.5, 10.0)}


def conics(k: eq.Setup, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Exact ellipses of random planes about the worked example's depth, and the planes."""
    rng = np.random.default_rng(1)
    z_L = rng.uniform(60, 500, n)
    alpha, beta = rng.uniform(0, np.radians(45), n), rng.uniform(-np.pi, np.pi, n)
    v = eq.PaperVariables(k.r / np.cos(alpha), z_L, alpha, beta)
    b = np.stack(eq.image_conic(np, v, k), axis=-1)
    planes = np.stack([z_L, *eq.slopes(np, v)], axis=-1)
    seen = eq.lit_side(np, v, k) > 0.05 * z_L
    return (b[:, 1:] / b[:, :1])[seen], planes[seen]


@pytest.mark.parametrize("route", ROUTES)
def test_vectorised(benchmark: BenchmarkFixture, route: str) -> None:
    k = ROUTES[route]
    B, planes = conics(k, N + N // 4)
    B, planes = B[:N], planes[:N]
    assert len(B) == N
    found = benchmark(solve_both, B, k)
    benchmark.group = f"{N} ellipses, closed form"
    benchmark.extra_info["what"] = route
    assert found.ok.all()
    # Exact ellipses give exact planes: what is lost is the conditioning, 1e6 at most in this range.
    assert np.max(np.abs(found.visible[:, 0] / planes[:, 0] - 1)) < 1e-9


def test_one_by_one(benchmark: BenchmarkFixture) -> None:
    """A thousand of them in a loop, which is what the vectorised form saves."""
    B, _ = conics(SETUP, 1000)

    def loop() -> int:
        return sum(bool(solve_both(row, SETUP).ok) for row in B)

    count = benchmark(loop)
    benchmark.group = f"{len(B)} ellipses in a loop"
    benchmark.extra_info["what"] = "one by one"
    assert count == len(B)
