"""The best flat attenuation of a band that any linear controller can reach."""

import numpy as np

from ultraquiet._base.constraints import Shape, positive, rising_band, whole
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.threads import single_threaded
from ultraquiet.limits._limit import Limit, refused
from ultraquiet.limits.delays import delayed
from ultraquiet.limits.demands import WHO, Wishes, checked_control, checked_error, checked_peak
from ultraquiet.limits.loops import stabilised
from ultraquiet.limits.search import LimitSearch
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

NO_PATH = 1e-15  # of what a plant answers anywhere: in the band it is round-off


@takes_systems
@single_threaded
def best_flat_attenuation(
    plant: StateSpace,
    band_hz: tuple[float, float],
    peak_db: Shape = 6.0,
    *,
    control_gain: Shape | None = None,
    noise_gain: float | None = None,
    delay_s: float = 0.0,
    uncertainty: "StateSpace | Shape | None" = None,
    basis: int = 80,
    certify: bool = True,
) -> Limit:
    """Return the best flat attenuation over a band that any linear controller can reach, and a proof from both sides.

    min t over stable Q:  |S| <= t in the band,  |S| <= peak everywhere,  |K S| <= control_gain,
    ||K S||_2 <= noise_gain;  S = I + G Q, K S = Q for a stable G, Youla's lines for an unstable one. With an
    uncertainty W, |S| is that of every plant (1 + E) G with |E| <= |W|: |S| / (1 - |W T|) <= t in the band and <= peak
    everywhere, which keeps |W T| < 1.

    Args:
        plant: G, one input and one output, continuous or discrete; for several see `by_direction`.
        band_hz: the band to be quiet, Hz.
        peak_db: largest amplification allowed at any frequency, dB; or a shape `(f_hz, dB)`, linear over log frequency,
            constant beyond its ends.
        control_gain: largest |K S|, output units of the controller per unit of disturbance at the plant's output; or a
            shape `(f_hz, gains)`. None allows 10^4 times what cancelling in the band takes. Where numbers that far
            apart are not solved, the controller is sought among those of less gain.
        noise_gain: largest RMS of the control per RMS of white sensor noise, ||K S||_2; discrete time only.
        delay_s: delay besides the plant's own; whole samples are exact, fractions an all-pass of first order.
        uncertainty: W of a relative error of the plant: a number, a shape `(f_hz, size)`, or a scalar system.
        basis: states of Q besides those of the plant. More come nearer to the bound.
        certify: compute `bound_db` too (about as long again).

    Returns:
        `Limit`. `attenuation_db` is reached by `controller`, which keeps every demand on a grid four times as fine as
        that of the programme; `bound_db` is reached by none, whatever its order (the noise gain is left out of it).
        `refused` where the uncertainty is one or more in the band: no controller makes every such plant quieter.

    Raises:
        InputError: the plant is not scalar, the band is empty or beyond Nyquist, a number makes no sense.

    An honest specification lies below the attenuation; one above the bound cannot be met, by no method whatever.

    >>> G = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=1000.0)
    >>> limit = best_flat_attenuation(G, (20.0, 100.0), 6.0, control_gain=10.0, basis=60)
    >>> bool(limit.attenuation_db < limit.bound_db < limit.attenuation_db + 1)
    True

    Boyd and Barratt 1991, "Linear Controller Design: Limits of Performance", chapters 7 and 15; the bound by Nehari's
    theorem, see `certificate`.
    """
    whole(WHO, "basis", basis, 7)
    band = rising_band(WHO, band_hz, plant.rate_hz)
    peak = checked_peak(WHO, peak_db, -300.0)
    if plant.D.shape != (1, 1):
        ny, nu = plant.D.shape
        raise InputError(f"{WHO}: the plant must have one input and one output, got {nu} and {ny}; use by_direction.")
    if noise_gain is not None:
        positive(WHO, "noise_gain", noise_gain)
        if plant.rate_hz is None:
            raise InputError(f"{WHO}: 'noise_gain' is for white noise in discrete time; sample the plant first.")
    error = checked_error(WHO, plant, uncertainty)
    plant = delayed(WHO, plant, delay_s)
    try:
        search = LimitSearch(stabilised(plant), band, basis)
    except NumericalError as error:
        return refused(f"{WHO}: {error}.")
    answers = np.abs(search.lines.b)
    if not answers[search.inside].max() > NO_PATH * answers.max():
        return refused(
            f"{WHO}: the plant does not answer in {band[0]:g}-{band[1]:g} Hz; nothing can be attenuated there."
        )
    gain, share = checked_control(WHO, control_gain, search.lines, search.inside)
    wishes = Wishes(band, peak, gain, error, share)
    most_db = 20 * float(np.log10(wishes.peaks(search.f_hz).max()))
    if most_db < 0 and not np.any(plant.D):
        return refused(
            f"{WHO}: a peak of {most_db:g} dB cannot be kept: a loop without direct path has S = 1 at infinity, "
            "and by the maximum principle at least 0 dB somewhere."
        )
    return search.limit(wishes, noise_gain, certify)
