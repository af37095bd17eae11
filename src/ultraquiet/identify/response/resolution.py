"""Whether a response estimated from a record resolves the modes of the model fitted to it."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.values import FrequencyResponse, StateSpace, Status, StatusWord

HANN = 1.5  # noise bandwidth of a Hann window, in lines
STANDS_OUT = 2.0  # by which a peak exceeds the response beside it, to be one


def blurred(model: StateSpace, response: FrequencyResponse) -> Status | None:
    """Return the verdict on a model whose sharpest mode the response is too coarse for; None where it is not.

    A window of noise bandwidth b lowers and widens a resonance whose half-power width w = 2 zeta f is no larger: the
    gain is biased by about (b / w)^2 / 3, and so is the damping (Bendat and Piersol, Random Data, 2010, section 8.5.2,
    doi:10.1002/9781118032428). A mode counts where the model's response stands out at it.
    """
    rate, f = model.rate_hz, response.f_hz
    if rate is None or f.size < 2:
        return None
    width = HANN * float(np.diff(f).min())
    poles = np.asarray(model.poles(), dtype=np.complex128)
    poles = poles[(poles.imag > 0) & (np.abs(poles) > 0)]
    hz, wide = (np.abs(x) * rate / np.pi for x in (np.angle(poles) / 2, np.log(np.abs(poles))))
    sharp = (wide < width) & (hz > f[0]) & (hz < f[-1])
    for k in np.flatnonzero(sharp)[np.argsort(wide[sharp], kind="stable")].tolist():
        if _stands_out(model, float(hz[k]), 2 * width, rate):
            return Status(
                StatusWord.POOR_FIT,
                f"The mode at {hz[k]:.4g} Hz, {wide[k]:.2g} Hz wide, is sharper than a response of this record "
                f"resolves, {width:.2g} Hz: leakage has changed its damping; record for longer, fit a periodic "
                f"response, or take 'subspace'.",
            )
    return None


def _stands_out(model: StateSpace, hz: float, apart: float, rate: float) -> bool:
    beside: FloatArray = np.clip([hz - apart, hz, hz + apart], 0.0, rate / 2)
    at = np.abs(model.frequency_response(beside))
    return bool(np.any(at[:, :, 1] > STANDS_OUT * np.maximum(at[:, :, 0], at[:, :, 2])))
