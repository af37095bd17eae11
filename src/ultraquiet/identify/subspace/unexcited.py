"""Bands in which a record's inputs are silent: it says nothing of the plant there, and a model may hold anything.

Least squares fill such a band with whatever serves the others, resonances many times the plant's gain among them, and a
controller believes them. Of all models that explain a record as well, the one that answers least where nothing was
asked is taken: the inputs are topped up in those bands by noise to which the outputs hold no answer.
"""

from dataclasses import replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.record_checks import heard_by
from ultraquiet.identify.subspace.fit import Scaled

SILENT = 1e-6  # of an input's mean power a line, below which a line is silent
LOUD = 2e-3  # of the loudest line, what counts as a tone: the window's side lobes lie below
LINES_A_TONE = 4  # that the window spreads a tone over, loud as above
WIDE = 0.01  # share of all lines that a silent band holds at least: the gaps of a multisine are none


def silent_bands(u: FloatArray) -> list[tuple[int, int]]:
    """Return first line and line after the last of each band in which all inputs `(nu, n)` are silent.

    >>> t = np.arange(1000)
    >>> u = sum(np.sin(2 * np.pi * k * t / 1000 + k**2) for k in range(1, 200))[None]
    >>> silent_bands(u)
    [(201, 501)]
    """
    return bands_of(_asked(u))


def tones_in(u: FloatArray) -> int:
    """Return about how many tones inputs `(nu, n)` hold, each of which tells two parameters of an output.

    >>> t = np.arange(1000)
    >>> tones_in(np.sin(0.02 * np.pi * t)[None]), tones_in(np.random.default_rng(0).standard_normal((1, 1000))) > 20
    (1, True)
    """
    lines = np.pad(_asked(u), ((0, 0), (1, 1)))
    tops = (lines[:, 1:-1] > lines[:, :-2]) & (lines[:, 1:-1] >= lines[:, 2:])
    loud = lines[:, 1:-1] > LOUD * lines.max(axis=1, keepdims=True)
    # The spectrum of a single blow is flat and has no tops but rounding's.
    return int(max(np.count_nonzero(np.any(tops & loud, axis=0)), np.count_nonzero(loud, axis=1).max() // LINES_A_TONE))


def _asked(u: FloatArray) -> FloatArray:
    """Return the power of inputs at each line, that of a blow near the ends of the record as well."""
    window = np.hanning(u.shape[1])
    return power(np.stack([heard_by(window, x) for x in u - u.mean(axis=1, keepdims=True)]))


def bands_of(power: FloatArray) -> list[tuple[int, int]]:
    """Return the silent bands of inputs of some power at each line, `(nu, lines)`."""
    quiet = np.all(power <= SILENT * power.mean(axis=1, keepdims=True), axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], quiet, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a >= WIDE * quiet.size]


def topped_up(data: Scaled, bands: list[tuple[int, int]]) -> Scaled:
    """Return the signals with noise in the bands where the inputs are silent, of which the outputs know nothing.

    min |y - G u|^2 + |G w|^2, which is |y - G (u + w)|^2 where u and w share no line. With rho the power of an output
    in the silent bands over that in the others (the median over outputs), and mean powers over lines throughout,
    |w|^2 = rho |u|^2: the gain that the plant has over the excited lines would answer as loudly as the noise, so the
    plant's own answer costs no more than noise does. Without noise, w is nothing. Other units change nothing.

    Hoerl and Kennard 1970, doi:10.1080/00401706.1970.10488634 (a penalty on what data do not tell).
    """
    if not bands:
        return data
    own = np.abs(np.fft.rfft(data.centred_u, axis=1)) ** 2
    return replace(data, u=data.u + noise(own, power(data.y), bands, data.samples))


def noise(own: FloatArray, heard: FloatArray, bands: list[tuple[int, int]], n: int) -> FloatArray:
    """Return n samples of noise for inputs of power `own`, outputs of power `heard` at the lines; see `topped_up`."""
    silent = np.concatenate([np.arange(a, b) for a, b in bands])
    excited = np.setdiff1d(np.arange(heard.shape[1]), silent)
    rho = float(np.median(heard[:, silent].mean(axis=1) / heard[:, excited].mean(axis=1)))
    size = np.sqrt(min(rho, 1.0) * np.mean(own[:, excited], axis=1))
    turns = np.random.default_rng(0).random((len(own), silent.size))
    added = np.zeros((len(own), heard.shape[1]), dtype=np.complex128)
    added[:, silent] = size[:, None] * np.exp(2j * np.pi * turns)
    added[:, 0] = 0.0
    return np.fft.irfft(added, n, axis=1)


def power(x: FloatArray) -> FloatArray:
    """Return the power of signals at each line, `(channels, lines)`; a window keeps what ends abruptly to itself."""
    centred = x - x.mean(axis=1, keepdims=True)
    return np.abs(np.fft.rfft(centred * np.hanning(x.shape[1]), axis=1)) ** 2
