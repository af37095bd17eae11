"""Plants as an identification leaves them possible, drawn from the covariance of the coefficients."""

from collections.abc import Iterator

import numpy as np

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import NumericalError
from ultraquiet.validate.bands import Identified, channels, root
from ultraquiet.validate.gradient import coefficients, with_coefficients
from ultraquiet.values import PolynomialMatrix, PolynomialModel, StateSpace

TRIES = 200  # of a channel, until one is stable


def drawn_plants(result: Identified, draws: int, seed: int = 0, stable: bool = True) -> Iterator[StateSpace]:
    """Yield plants drawn from N(theta, P), each channel's coefficients by their own covariance.

    Args:
        result: of a polynomial method, with covariance.
        draws: how many.
        seed: of the draws.
        stable: draw a channel again until it is stable: a bench that stood still when left alone is.

    Raises:
        InputError: no covariance (state-space results).
        NumericalError: a channel that is never stable.

    What chance did to the record is in it, what the structure left out is not: look at the residual tests first.

    >>> import numpy as np, ultraquiet as uq
    >>> u, e = np.random.default_rng(1).standard_normal((2, 2000))
    >>> lag = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=10.0)
    >>> record = uq.Record(u, lag.state_space().simulate(u[None]) + 0.1 * e, 10.0)
    >>> plants = list(drawn_plants(uq.identify.OutputError(order=1).identify(record), 20))
    >>> bool(0 < np.std([plant.A[0, 0] for plant in plants]) < 0.02)
    True
    """
    whole("drawn_plants", "draws", draws, 1)
    whole("drawn_plants", "seed", seed, 0)
    parts = [(model, coefficients(model), root(P)) for model, P in channels("drawn_plants", result)]
    return _plants(result.model, parts, draws, np.random.default_rng(seed), stable)


def _plants(
    matrix: PolynomialMatrix,
    parts: list[tuple[PolynomialModel, np.ndarray, np.ndarray]],
    draws: int,
    rng: np.random.Generator,
    stable: bool,
) -> Iterator[StateSpace]:
    for _ in range(draws):
        models = iter([_one(*part, rng, stable) for part in parts])
        rows = [[next(models) for _ in row] for row in matrix.rows]
        yield PolynomialMatrix(rows, matrix.actuators, matrix.sensors, matrix.provenance).state_space()


def _one(
    model: PolynomialModel, theta: np.ndarray, L: np.ndarray, rng: np.random.Generator, stable: bool
) -> PolynomialModel:
    for _ in range(TRIES):
        sample = with_coefficients(model, theta + L @ rng.standard_normal(L.shape[1]))
        if not stable or sample.is_stable():
            return sample
    raise NumericalError(
        f"drawn_plants: none of {TRIES} draws of a channel is stable; its covariance is too large to stand for a plant."
    )
