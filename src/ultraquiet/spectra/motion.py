"""Displacement, velocity and acceleration into one another, in the frequency domain."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np

from ultraquiet._base.constraints import FloatArray, frozen, one_of
from ultraquiet._base.errors import InputError
from ultraquiet.spectra.psd import PowerSpectrum
from ultraquiet.values import Channel, FrequencyResponse
from ultraquiet.values.handed_over.kinds import of_kind, takes_values

# How many times each is differentiated from displacement.
QUANTITIES = MappingProxyType({"displacement": 0, "velocity": 1, "acceleration": 2})
LADDERS = tuple(
    (length, f"{length}/s", f"{length}/s{squared}")
    for length in ("m", "mm", "µm", "um")
    for squared in ("²", "^2", "2")
)
STANDARD_GRAVITY = 9.80665


def convert_spectrum(spectrum: PowerSpectrum, given: str, wanted: str) -> PowerSpectrum:
    """Return a density of displacement, velocity or acceleration as one of the others.

    S_wanted = (2 pi f)^(2 k) S_given, k the number of differentiations, negative for integrations

    Args:
        spectrum: densities whose channels are all `given`; units are followed from m, mm or µm on (g becomes m/s²).
        given: "displacement", "velocity" or "acceleration".
        wanted: likewise.

    Returns:
        The density; an integral leaves out 0 Hz. Noise below the first few lines grows as f^-2 with each integration.

    Raises:
        InputError: an unknown quantity, a channel whose unit contradicts `given`.

    >>> from ultraquiet.spectra import psd
    >>> t = np.arange(4000) / 1000.0
    >>> a = psd(np.sin(2 * np.pi * 50.0 * t), rate_hz=1000.0, segment_samples=1000)
    >>> float(round(convert_spectrum(a, "acceleration", "velocity").rms(40, 60)[0] * 2 * np.pi * 50 * np.sqrt(2), 3))
    1.0
    """
    spectrum = of_kind("convert_spectrum", "spectrum", spectrum, PowerSpectrum)
    steps, factors, channels = _plan("convert_spectrum", spectrum.channels, given, wanted)
    lines = spectrum.f_hz > 0 if steps < 0 else np.ones(spectrum.f_hz.size, dtype=bool)
    weight = (2.0 * np.pi * spectrum.f_hz[lines]) ** (2.0 * steps)
    values = spectrum.values[:, lines] * weight * (factors**2)[:, np.newaxis]
    return replace(spectrum, f_hz=frozen(spectrum.f_hz[lines]), values=frozen(values), channels=channels)


@takes_values
def convert_response(response: FrequencyResponse, given: str, wanted: str) -> FrequencyResponse:
    """Return a response whose outputs are one kind of motion as that of another, with its variance.

    G_wanted = (j 2 pi f)^k G_given

    Args:
        response: `(ny, nu, nf)` whose sensors are all `given`.
        given: "displacement", "velocity" or "acceleration".
        wanted: likewise.

    Raises:
        InputError: an unknown quantity, a sensor whose unit contradicts `given`.

    >>> receptance = FrequencyResponse([1.0, 2.0], [[[1.0, 1.0]]])
    >>> convert_response(receptance, "displacement", "acceleration").values.real.round(1).ravel().tolist()
    [-39.5, -157.9]
    """
    steps, factors, channels = _plan("convert_response", response.sensors, given, wanted)
    lines = response.f_hz > 0 if steps < 0 else np.ones(response.f_hz.size, dtype=bool)
    weight = (2j * np.pi * response.f_hz[lines]) ** steps * factors[:, np.newaxis, np.newaxis]
    coherence, variance = response.coherence, response.variance
    return FrequencyResponse(
        response.f_hz[lines],
        response.values[:, :, lines] * weight,
        None if coherence is None else coherence[:, :, lines],
        response.estimator,
        response.actuators,
        channels,
        response.provenance,
        None if variance is None else variance[:, :, lines] * np.abs(weight) ** 2,
    )


def _plan(
    who: str, channels: tuple[Channel, ...], given: str, wanted: str
) -> tuple[int, FloatArray, tuple[Channel, ...]]:
    """Return the number of differentiations, a factor for each channel, and the channels with their new units."""
    one_of(who, "given", given, tuple(QUANTITIES))
    one_of(who, "wanted", wanted, tuple(QUANTITIES))
    pairs = [_unit(who, c, QUANTITIES[given], QUANTITIES[wanted]) for c in channels]
    # Limits belong to the quantity that was read, so they are not carried over.
    converted = tuple(
        c if given == wanted else Channel(c.name, unit) for c, (_, unit) in zip(channels, pairs, strict=True)
    )
    return QUANTITIES[wanted] - QUANTITIES[given], np.array([factor for factor, _ in pairs]), converted


def _unit(who: str, channel: Channel, given: int, wanted: int) -> tuple[float, str]:
    if channel.unit == "g" and given == QUANTITIES["acceleration"]:
        return (1.0, "g") if wanted == given else (STANDARD_GRAVITY, LADDERS[0][wanted])
    for ladder in LADDERS:
        if channel.unit == ladder[given]:
            return 1.0, ladder[wanted]
    known = {unit for ladder in LADDERS for unit in ladder} | {"g"}
    if channel.unit in known:
        raise InputError(
            f"{who}: channel '{channel.name}' is in {channel.unit}, which is no {tuple(QUANTITIES)[given]}."
        )
    # Volts and unnamed units: the number is converted, the unit says how.
    return 1.0, channel.unit if given == wanted else f"{channel.unit}·s^{given - wanted}"
