"""Three hundred drawn H-infinity problems, each answer verified outside the package."""

import numpy as np
import pytest
from drawn_problems import FAMILIES, problem

from ultraquiet.design import synthesize_hinf

DRAWS = 30  # of each family and four more, nine families, and the slowest
FEW = 4  # of the slowest
BEST = 1.001  # achieved, over the smallest norm of any controller that was verified
EXACT = 1e-6
FAN = np.linspace(-1, 1, 41)
GRID = 100  # frequencies from the slowest pole to the fastest: a loop near its optimum is flat and peaks anywhere


def closed(P, K, ny, nu):
    """Return the loop of P and K, written without the package; D22 may be any.

    In extended precision: of a law near its optimum the sums of large products cancel, and a loop that is rounded has
    another norm in the sixth digit.
    """
    p, m = P.D.shape[0] - ny, P.D.shape[1] - nu
    A, B, C, D, a, b, c, d = (x.astype(np.longdouble) for S in (P, K) for x in (S.A, S.B, S.C, S.D))
    B1, B2, C1, C2 = B[:, :m], B[:, m:], C[:p], C[p:]
    D11, D12, D21, D22 = D[:p, :m], D[:p, m:], D[p:, :m], D[p:, m:]
    wrap = np.eye(nu) - d @ D22
    M = np.linalg.inv(wrap.astype(float)).astype(np.longdouble)
    M += M @ (np.eye(nu) - wrap @ M)
    u = np.hstack([M @ d @ C2, M @ c, M @ d @ D21])
    y = np.hstack([C2, np.zeros((ny, K.states)), D21]) + D22 @ u
    n = P.states
    state = np.vstack(
        [
            np.hstack([A, np.zeros((n, K.states)), B1]) + B2 @ u,
            np.hstack([np.zeros((K.states, n)), a, 0 * b @ D21]),
        ]
    )
    state[n:] += b @ y
    out = np.hstack([C1, np.zeros((p, K.states)), D11]) + D12 @ u
    both = n + K.states
    return state[:, :both], state[:, both:], out[:, :both], out[:, both:]


def even(A, B, C):
    """Return A, B, C with states scaled by powers of two until rows and columns match: plain Osborne sweeps."""
    A, B, C = A.copy(), B.copy(), C.copy()
    for _ in range(30):
        for k in range(len(A)):
            row = np.hypot(np.linalg.norm(np.delete(A[k], k)), np.linalg.norm(B[k]))
            column = np.hypot(np.linalg.norm(np.delete(A[:, k], k)), np.linalg.norm(C[:, k]))
            if row > 0 and column > 0:
                d = np.exp2(np.round(np.log2(row / column) / 2))
                A[k] /= d
                B[k] /= d
                A[:, k] *= d
                C[:, k] *= d
    return A, B, C


def gain_at(M, w, rate_hz):
    """Return the gain at one frequency, the solution improved by its residuals in extended precision."""
    A, B, C, D = M
    z = 1j * w if rate_hz is None else np.exp(1j * w)
    wide = z * np.eye(len(A), dtype=np.clongdouble) - A
    inverse = np.linalg.inv(wide.astype(complex))
    x = (inverse @ B).astype(np.clongdouble)
    for _ in range(3):
        x += inverse @ (B - wide @ x).astype(complex)
    return float(np.linalg.norm((C @ x + D).astype(complex), 2))


def verified(P, K, ny, nu, claimed, f_hz):
    """Return whether the loop is stable and its norm the one claimed: the gain is looked for at every pole and around.

    The gain at the place named bounds the norm from below; that no other place exceeds it is looked at where a pole
    could raise it, and on a grid.
    """
    A, B, C, D = closed(P, K, ny, nu)
    A, B, C = even(A, B, C)
    poles = np.linalg.eigvals(A.astype(float))
    discrete = P.rate_hz is not None
    assert (np.abs(poles).max() < 1) if discrete else (poles.real.max() < 0)
    M = (A, B, C, D)
    at = f_hz * 2 * np.pi / (P.rate_hz or 1.0)
    w = np.abs(np.angle(poles)) if discrete else np.abs(poles)
    between = np.geomspace(max(w.min(), 1e-9 * w.max()), w.max(), GRID) if np.any(w) else []
    looks = [at, *w, *(np.abs(poles.imag) if not discrete else []), *(at * (1 + 1e-3 * FAN)), *between]
    top = np.linalg.norm(D.astype(float), 2) if not discrete else 0.0
    gains = [gain_at(M, x, P.rate_hz) for x in looks if np.isfinite(x)]
    return max([top, *gains]) / claimed - 1


def answer(family, seed):
    """Solve a problem and look at the answer from outside; return it with what was found."""
    P, ny, nu = problem(family, seed)
    result = synthesize_hinf(P, ny, nu, regularise=True)
    assert result.status.ok, f"{family} {seed}: {result.status}"
    off = verified(P, result.controller, ny, nu, result.achieved, result.details["achieved_hz"])
    assert abs(off) < EXACT, f"{family} {seed}: the norm claimed is off by {off:.1e}"
    if "regularised" in result.details:
        best = result.details["optimum"][1]
    else:
        other = synthesize_hinf(P, ny, nu, margin=1.02, second_opinion=False)
        best = min(result.achieved, other.achieved, result.details["optimum"][1])
    assert result.achieved <= BEST * best * (1 + EXACT), f"{family} {seed}: {result.achieved:.7g} against {best:.7g}"
    opinion = result.details.get("second_opinion")
    if opinion is not None and not opinion.agrees:
        assert not opinion.decided, f"{family} {seed}: {opinion.sentence}"
    return result


@pytest.mark.parametrize("family", sorted(set(FAMILIES) - {"large"}))
def test_one_of_each_family(family):
    answer(family, 1)


@pytest.mark.parametrize(("family", "draw"), [("delays", 15), ("integrators", 27), ("singular", 33), ("dense", 33)])
def test_peaks_at_rest_that_modal_coordinates_misjudge(family, draw):
    """By up to a ten-thousandth: poles of delays at z = 0, or so far apart that the modes' condition is 1e7."""
    answer(family, draw)


def test_the_peak_of_a_flat_loop_that_stands_between_its_poles():
    """Modal coordinates are off by 5e-6 there, and where poles lead to 177101 of 177113 was found."""
    answer("dense", 17)


def test_a_double_integrator_bounds_nothing_from_below():
    """Rounding makes a pair of it, whose residues once proved a level out of reach that is 2.5 times too high."""
    assert answer("integrators", 17).achieved < 0.7975


def test_a_controller_of_large_terms_is_returned_in_coordinates_that_hold_it():
    """At 1e7 beside closed-loop poles at 0.1, nothing but round-off was left of the loop's fifth digit."""
    result = answer("descriptors", 3)
    assert np.linalg.norm(result.controller.A) < 10 * np.abs(result.controller.poles()).max()


@pytest.mark.slow
@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_the_collection(family):
    draws = FEW if family == "large" else DRAWS + 4
    found = [answer(family, seed) for seed in range(draws)]
    opinions = [r.details["second_opinion"] for r in found if "second_opinion" in r.details]
    undecided = sum(not o.decided for o in opinions)
    hidden = sum(r.details.get("hidden", 0) > 0 for r in found)
    print(
        f"{family}: {draws} solved and verified, {len(opinions)} second opinions, {undecided} of them undecided, "
        f"{hidden} with hidden states"
    )
