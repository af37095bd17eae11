"""Constant gains for twenty public problems, beside the best H-infinity norms that were published for them."""

from pathlib import Path

import numpy as np
import pytest

from ultraquiet.analyse import hinf_norm
from ultraquiet.design import synthesize_structured
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import lft

DATA = Path(__file__).parents[1] / "data" / "problems" / "static_output_feedback.npz"
# The lowest of those of HIFOO, PENBMI and convex-concave decompositions (Tran Dinh, Gumussoy, Michiels and Diehl 2012,
# doi:10.1109/TAC.2011.2176154) and of non-smooth search (Apkarian and Noll 2006, doi:10.1109/TAC.2005.860290).
PUBLISHED = {
    "AC2": 0.1115,
    "AC4": 0.9355,
    "AC6": 4.1140,
    "AC7": 0.0651,
    "AC8": 2.0050,
    "AC12": 0.3120,
    "AC17": 6.6124,
    "HE1": 0.1538,
    "HE4": 22.8282,
    "HE5": 8.8952,
    "REA3": 74.2513,
    "DIS1": 4.1716,
    "DIS3": 1.0816,
    "TG1": 12.8462,
    "AGS": 8.1732,
    "MFP": 31.5899,
    "PSM": 0.9202,
    "EB1": 3.1225,
    "NN2": 2.2216,
    "NN17": 11.2182,
}
WITHIN, OF_TWENTY = 1.01, 18


def problem(name):
    """Return the generalised plant of a problem, and the numbers of its measurements and controls."""
    with np.load(DATA) as z:
        A, B1, B, C1, C, D11, D12, D21 = (z[f"{name}_{k}"] for k in ("A", "B1", "B", "C1", "C", "D11", "D12", "D21"))
    ny, nu = len(C), B.shape[1]
    D = np.block([[D11, D12], [D21, np.zeros((ny, nu))]])
    return StateSpace(A, np.hstack([B1, B]), np.vstack([C1, C]), D), ny, nu


@pytest.mark.slow
def test_twenty_public_problems():
    near = []
    for name, best in PUBLISHED.items():
        P, ny, nu = problem(name)
        result = synthesize_structured(P, ny, nu, states=0)
        assert result.controller is not None, f"{name}: {result.status}"
        loop = lft(P, result.controller)
        assert loop.poles().real.max() < 0
        found = hinf_norm(loop)[0]
        near.append(found <= WITHIN * best)
        said = result.status.word
        print(
            f"{name:5} {P.states:2} states  found {found:9.5g}  published {best:9.5g}  ratio {found / best:.4f}  {said}"
        )
    print(f"{sum(near)} of {len(near)} within {WITHIN - 1:.0%} of the published best, or better")
    assert sum(near) >= OF_TWENTY


@pytest.mark.gate("AC17")
@pytest.mark.parametrize("name", ["NN2", "AC17"])
def test_one_measurement_or_two(name):
    P, ny, nu = problem(name)
    found = synthesize_structured(P, ny, nu, states=0, starts=2).achieved
    assert found <= WITHIN * PUBLISHED[name]
