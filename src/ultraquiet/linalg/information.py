"""Criteria that weigh a model's loss against the number of its coefficients, on plain numbers."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray

NAMES = ("fpe", "aic", "aicc", "bic", "mdl")


class Criteria(NamedTuple):
    """What the same model would cost on another record, by five rules; the least wins, comparisons only.

    `fpe` and `mdl` are in squared output units, the others are logarithms times the number of samples.
    """

    fpe: FloatArray
    aic: FloatArray
    aicc: FloatArray
    bic: FloatArray
    mdl: FloatArray


def criteria(loss: ArrayLike, samples: int, parameters: ArrayLike, past: ArrayLike = 0.0) -> Criteria:
    """Return the criteria of a mean squared one-step error V over n samples with p coefficients fitted to them.

    FPE = V (n + q) / (n - q), AIC = n ln V + 2 q, AICc = AIC + 2 q (q + 1) / (n - q - 1), BIC = n ln V + p ln n,
    MDL = V (1 + p ln n / n). Constants common to all models are left out. Too few samples (n <= q + 1) cost infinity.

    q = p + `past`: a fitted initial condition takes as much of the error as any coefficient, and has to be fitted again
    to another record. What a record tells of it does not grow with n, so that it costs no ln n.

    References: Akaike 1974, doi:10.1109/TAC.1974.1100705; Hurvich and Tsai 1989, doi:10.1093/biomet/76.2.297; Schwarz
    1978, doi:10.1214/aos/1176344136; Rissanen 1978, doi:10.1016/0005-1098(78)90005-5; Ljung, System Identification,
    2nd ed., section 16.4.

    >>> [round(float(x), 3) for x in criteria(1.0, 100, 2)]
    [1.041, 4.0, 4.124, 9.21, 1.092]
    """
    V, p, n = np.asarray(loss, dtype=float), np.asarray(parameters, dtype=float), float(samples)
    q = p + np.asarray(past, dtype=float)
    spare = n - q - 1
    with np.errstate(divide="ignore", invalid="ignore"):
        level = n * np.log(V)
        fpe = np.where(spare > 0, V * (n + q) / (n - q), np.inf)
        aicc = np.where(spare > 0, level + 2 * q + 2 * q * (q + 1) / spare, np.inf)
    return Criteria(fpe, level + 2 * q, aicc, level + p * np.log(n), V * (1 + p * np.log(n) / n))
