"""Threefold symmetry: six functions in the place of 36, drawn from all 36 responses, and a test that it is so."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown.line import p_in_words
from ultraquiet.identify.grey_box.data import smoothed
from ultraquiet.identify.grey_box.modal import StructuredModal
from ultraquiet.identify.result import SIGNIFICANCE, worst
from ultraquiet.values import FrequencyResponse, StateSpace, Status, StatusWord
from ultraquiet.values.handed_over.kinds import takes_values

WHO = "Threefold"
STRUTS = 6
LOOPS = ("alike", "opposed", "sway and rock")
# Columns of the transform that belong to each loop; the last is there twice.
PLACES = ((0,), (1,), (2, 3), (4, 5))
FLIPS = 1999  # random signs drawn: p-values down to 1 in 2000
SMOOTHED_LINES = 15
LEAST_REALISATIONS = 4


@dataclass(frozen=True, eq=False)
class Folded:
    """A 6 x 6 response taken apart.

    Attributes:
        loops: three responses: 1 x 1 (all struts alike), 1 x 1 (neighbours opposed), 2 x 2 (sway and rock), each with
            the variance that averaging leaves.
        p_value: that what the symmetry forbids is noise; NaN where the noise is not known.
        asymmetry: `(nf,)` RMS of what the symmetry forbids as a share of the response; noise is in it.
        status: `ok` or `not symmetric`.
    """

    loops: tuple[FrequencyResponse, FrequencyResponse, FrequencyResponse]
    p_value: float
    asymmetry: FloatArray
    status: Status


def transform() -> FloatArray:
    """Return the constant orthonormal T with T' G T = diag(g_1, g_2, H, H), `(6, 6)`.

    >>> T = transform()
    >>> bool(np.allclose(T.T @ T, np.eye(6)))
    True
    """
    from ultraquiet.bench.hexapod.physics.geometry import decoupling

    return decoupling()


def contrasts() -> tuple[FloatArray, FloatArray]:
    """Return orthonormal rows that pick from the 36 responses the 6 functions and the 30 that symmetry forbids.

    Rows act on G.ravel(); the 6 are g_1, g_2 and H row by row, each an average of all responses that hold it.

    >>> [len(rows) for rows in contrasts()]
    [6, 30]
    """
    T = transform()
    entry = np.einsum("ai,bj->ijab", T, T).reshape(STRUTS, STRUTS, -1)  # (i, j) of T' G T as rows on G.ravel()
    wanted = [entry[0, 0], entry[1, 1]]
    forbidden = []
    (a, b), (c, d) = PLACES[2], PLACES[3]
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        first, second = entry[(a, b)[i], (a, b)[j]], entry[(c, d)[i], (c, d)[j]]
        wanted.append((first + second) / np.sqrt(2.0))
        forbidden.append((first - second) / np.sqrt(2.0))
    block = {i: n for n, place in enumerate(PLACES) for i in place}
    forbidden += [entry[i, j] for i in range(STRUTS) for j in range(STRUTS) if block[i] != block[j]]
    return np.array(wanted), np.array(forbidden)


@takes_values
def fold(responses: FrequencyResponse | Sequence[FrequencyResponse], seed: int = 0) -> Folded:
    """Take a 6 x 6 response apart into the functions of a threefold symmetric hexapod, and test that it is one.

    T' G T = diag(g_1, g_2, H, H). Each of the six functions averages all responses that hold it, which lowers its
    variance up to sixfold. The 30 other combinations vanish for a hexapod whose struts are alike.

    With one response the test is chi-squared with its `variance`, noise taken as independent from channel to channel.
    That does not hold for nonlinear distortion, which enters at one actuator and reaches all sensors: then give the
    responses of the realisations one by one. Their mean is folded, its variance comes from their scatter, and random
    signs of what is forbidden, realisation by realisation and line by line, give the distribution of the statistic
    whatever the correlation.

    Args:
        responses: `(6, 6, nf)`, struts numbered round the hexapod; or one a realisation, on the same lines.
        seed: of the random signs.

    Raises:
        InputError: not 6 x 6, different lines, too few realisations.

    Reference: doi:10.1109/9.793723 for systems with symmetric structure; Fisher 1935 for random signs.
    """
    realisations = [responses] if isinstance(responses, FrequencyResponse) else list(responses)
    if not realisations:
        raise InputError(f"{WHO}: no responses were given; at least one is needed.")
    whole(WHO, "seed", seed, 0)
    G = np.array([_checked(r, realisations[0]) for r in realisations])
    mean = G.mean(axis=0)
    wanted, forbidden = contrasts()
    x = forbidden @ G.reshape(len(G), STRUTS**2, -1)
    if len(realisations) == 1:
        variance = realisations[0].variance
        p_value = float("nan") if variance is None else _chi_squared(x[0], forbidden, variance)
        variance = None if variance is None else wanted**2 @ variance.reshape(STRUTS**2, -1)
    else:
        # Distortion that enters at one actuator is alike at all sensors: the functions' own scatter knows it.
        variance = (wanted @ G.reshape(len(G), STRUTS**2, -1)).var(axis=0, ddof=1) / len(G)
        p_value = _random_signs(x, seed)
    share = np.linalg.norm(x.mean(axis=0), axis=0) / np.linalg.norm(mean, axis=(0, 1))
    loops = _loops(wanted @ mean.reshape(STRUTS**2, -1), variance, realisations[0])
    return Folded(loops, p_value, share, _verdict(p_value, share))


def _checked(response: FrequencyResponse, first: FrequencyResponse) -> ComplexArray:
    if response.values.shape[:2] != (STRUTS, STRUTS):
        ny, nu = response.values.shape[:2]
        raise InputError(
            f"{WHO}: six struts with an actuator and a sensor each are needed, the response is {ny} x {nu}."
        )
    if not np.array_equal(response.f_hz, first.f_hz):
        raise InputError(f"{WHO}: all realisations must have the same lines.")
    return response.values


def _loops(
    f: ComplexArray, v: FloatArray | None, source: FrequencyResponse
) -> tuple[FrequencyResponse, FrequencyResponse, FrequencyResponse]:
    out = []
    for name, rows, size, scale in zip(
        LOOPS, ([0], [1], [2, 3, 4, 5]), (1, 1, 2), (1.0, 1.0, np.sqrt(0.5)), strict=True
    ):
        out.append(
            FrequencyResponse(
                source.f_hz,
                (scale * f[rows]).reshape(size, size, -1),
                estimator=f"{source.estimator}, {name}",
                provenance=Provenance("identify.fold", {"loop": name}, parents=source.provenance.parents),
                variance=None if v is None else (scale**2 * v[rows]).reshape(size, size, -1),
            )
        )
    return out[0], out[1], out[2]


def _chi_squared(x: ComplexArray, forbidden: FloatArray, variance: FloatArray) -> float:
    from scipy.special import chdtrc

    smooth = smoothed(variance.reshape(STRUTS**2, -1), SMOOTHED_LINES)
    covariance = np.einsum("ca,af,da->fcd", forbidden, smooth, forbidden)
    solved = np.linalg.solve(covariance, x.T[:, :, None])[:, :, 0]
    statistic = 2.0 * float(np.sum((x.T.conj() * solved).real))
    return float(chdtrc(2 * x.size, statistic))


def _random_signs(x: ComplexArray, seed: int) -> float:
    """Return the share of random signs that make the mean of the realisations as large as it is."""
    count = len(x)
    if count < LEAST_REALISATIONS:
        raise InputError(f"{WHO}: {count} realisations are too few to tell noise from asymmetry, take at least 6.")
    # About zero, not about the mean: signs leave it as it is, and the share of signs is then exact.
    size = np.maximum(smoothed(np.mean(np.abs(x) ** 2, axis=0), SMOOTHED_LINES), np.finfo(float).tiny)
    x = x / np.sqrt(size)
    rng = np.random.default_rng(seed)
    # |sum_m s_m x_m|^2 = s' (x^H x) s: the Gram matrix of the realisations at each line is all that signs act on.
    gram = np.einsum("mcf,ncf->fmn", x.conj(), x).real
    signs = rng.choice([-1.0, 1.0], size=(FLIPS, gram.shape[0], count))
    statistics = np.einsum("kfm,fmn,kfn->k", signs, gram, signs, optimize=True)
    return float((1 + np.count_nonzero(statistics >= gram.sum())) / (FLIPS + 1))


def _verdict(p_value: float, share: FloatArray) -> Status:
    size = 100 * float(np.median(share))
    if p_value < SIGNIFICANCE:
        return Status(
            StatusWord.NOT_SYMMETRIC,
            f"The struts are not alike ({p_in_words(p_value)}): what a threefold symmetry forbids is {size:.2g} % of "
            f"the response (median line); identify all 36 functions.",
        )
    evidence = (
        "its noise is not known, so this is not tested"
        if np.isnan(p_value)
        else f"noise explains it (p = {p_value:.2g})"
    )
    return Status(
        StatusWord.OK, f"What a threefold symmetry forbids is {size:.2g} % of the response (median line); {evidence}."
    )


class OfResponses(Protocol):
    """A method that fits a response: `Rational`, `StructuredModal`."""

    def identify_response(self, response: FrequencyResponse, rate_hz: float) -> Any:
        """Return a fit with `model` and `status`."""
        ...


@dataclass(frozen=True, eq=False)
class ThreefoldFit:
    """A hexapod of six functions.

    Attributes:
        model: 6 x 6, T diag(g_1, g_2, H, H) T'.
        status: the worst of the three loops', or `not symmetric`.
        folded: the responses of the loops and the test of the symmetry.
        loops: what the method returned for each of the three.
    """

    model: StateSpace
    status: Status
    folded: Folded
    loops: tuple[Any, Any, Any]


@dataclass(frozen=True)
class Threefold:
    """Identify the six functions of a threefold symmetric hexapod from all 36 responses.

    Args:
        method: fits each loop; anything with `identify_response`.
        seed: of the random signs of the test, see `fold`.
    """

    method: OfResponses = field(default_factory=StructuredModal)
    seed: int = 0

    def identify_response(
        self, responses: FrequencyResponse | Sequence[FrequencyResponse], rate_hz: float
    ) -> ThreefoldFit:
        """Return the 6 x 6 model; see `fold` for the arguments and for when to give realisations one by one.

        A unit that fails the test is fitted all the same, as the symmetric unit nearest to it, and says so.
        """
        folded = fold(responses, self.seed)
        fits = [self.method.identify_response(loop, rate_hz) for loop in folded.loops]
        first = responses if isinstance(responses, FrequencyResponse) else responses[0]
        model = unfolded([fit.model for fit in fits], first, Provenance("identify.threefold", {}))
        status = worst([fit.status for fit in fits]) if folded.status.ok else folded.status
        return ThreefoldFit(model, status, folded, (fits[0], fits[1], fits[2]))


def unfolded(loops: Sequence[StateSpace], source: FrequencyResponse, provenance: Provenance) -> StateSpace:
    """Return T diag(g_1, g_2, H, H) T' as one system."""
    from scipy.linalg import block_diag

    g_1, g_2, H = loops
    parts = (g_1, g_2, H, H)
    T = transform()
    A, B, C, D = (np.asarray(block_diag(*(getattr(p, k) for p in parts)), dtype=np.float64) for k in "ABCD")
    return StateSpace(A, B @ T.T, T @ C, T @ D @ T.T, g_1.rate_hz, source.actuators, source.sensors, provenance)
