"""Variance of responses that came with a coherence alone, from a file for instance."""

import numpy as np

from ultraquiet._base.constraints import between
from ultraquiet._base.errors import InputError
from ultraquiet.values import FrequencyResponse
from ultraquiet.values.handed_over.kinds import takes_values

# A coherence of one to the last digit tells the precision of a file, not of a measurement.
NEAREST_TO_ONE = 1e-9
# One average alone has coherence one whatever the noise.
FEWEST = 1.5


@takes_values
def with_coherence_variance(response: FrequencyResponse, averages: float) -> FrequencyResponse:
    """Return the response with the variance that its coherence tells: |G|^2 (1 - c) / (c K), K averages.

    Args:
        response: `(ny, nu, nf)` with a coherence, each input excited alone.
        averages: independent averages behind it, above one; overlapping segments count for less than their number.

    Returns:
        The same gains; a coherence from few averages is biased upwards by about (1 - c) / K, which is taken off. Lines
        of no coherence have infinite variance.

    Raises:
        InputError: a response without coherence.

    >>> g = FrequencyResponse([1.0], [[[2.0]]], coherence=[[[0.9]]])
    >>> float(with_coherence_variance(g, averages=1000).variance[0, 0, 0].round(6))
    0.000445

    Reference: J. S. Bendat, A. G. Piersol, Random Data (2010), table 9.6, doi:10.1002/9781118032428.
    """
    if response.coherence is None:
        raise InputError("with_coherence_variance: the response carries no coherence; measure one, or use Rational.")
    K = between("with_coherence_variance", "averages", averages, FEWEST, 1e9)
    c = np.clip(response.coherence, 0.0, 1.0 - NEAREST_TO_ONE)
    c = np.clip((K * c - 1.0) / (K - 1.0), 0.0, 1.0)
    with np.errstate(divide="ignore"):
        share = np.where(c > 0, (1.0 - c) / np.where(c > 0, c, 1.0), np.inf) / K
    size = np.abs(response.values) ** 2
    return FrequencyResponse(
        response.f_hz,
        response.values,
        response.coherence,
        response.estimator,
        response.actuators,
        response.sensors,
        response.provenance,
        share * np.maximum(size, np.finfo(float).tiny),
    )
