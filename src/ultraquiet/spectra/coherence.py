"""Ordinary, partial and multiple coherence between inputs and outputs of a record."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, frozen
from ultraquiet.spectra import estimators
from ultraquiet.spectra.averaging import Averaging
from ultraquiet.spectra.cross import CrossSpectra, cross_spectra
from ultraquiet.spectra.excited import Group, alive_lines, refuse_dead_outputs
from ultraquiet.values import Channel, Record

# Where a line is more answer than noise: half of the output's power, and no more, comes from elsewhere.
TRUSTED = 0.5


@dataclass(frozen=True, eq=False)
class Coherence:
    """Shares of power between 0 and 1; without any relation they still read about 1 / averages per input.

    `ordinary` and `partial` are `(output, input, frequency)`, `multiple` is `(output, frequency)`.
    """

    f_hz: FloatArray
    ordinary: FloatArray
    partial: FloatArray
    multiple: FloatArray
    averaging: Averaging
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]

    @property
    def estimator(self) -> str:
        """Window, averages, overlap and resolution."""
        return self.averaging.text


def coherence(
    record: Record | CrossSpectra,
    segment_samples: int | None = None,
    overlap: float = 0.5,
    window: str = "hann",
    detrend: str = "constant",
) -> Coherence:
    """Return how much of each output the inputs explain: alone, one beside the others, and all together.

    ordinary |S_yu|^2 / (S_yy S_uu), partial the same after the other inputs' share is removed from both, multiple
    1 - S_yy.u / S_yy.

    Args:
        record: a record, or cross spectra, whose averaging then stands.
        segment_samples: length of a segment; by default an eighth of the record.
        overlap: shared part of neighbouring segments, 0 to 0.95.
        window: any window name of scipy.signal.
        detrend: what is removed from every segment: "constant", "linear" or "none".

    Raises:
        InputError: as `frf`.

    >>> u = np.random.default_rng(0).standard_normal((2, 4096))
    >>> result = coherence(Record(u, u.sum(axis=0), rate_hz=1000.0))
    >>> bool(result.multiple.min() > 0.999), bool(result.ordinary.mean() < 0.6)
    (True, True)

    Reference: Bendat and Piersol 2010, chapter 7, doi:10.1002/9781118032428.
    """
    cross = (
        record if isinstance(record, CrossSpectra) else cross_spectra(record, segment_samples, overlap, window, detrend)
    )
    nu, ny = len(cross.actuators), len(cross.sensors)
    moving = cross.moving(range(nu))
    group = Group(cross, moving)
    refuse_dead_outputs("coherence", [group])
    alive = alive_lines("coherence", cross, moving)
    s = group.blocks(moving, range(nu, nu + ny), alive)
    return Coherence(
        frozen(cross.f_hz[alive]),
        frozen(np.moveaxis(estimators.ordinary(s), 0, -1)),
        frozen(np.moveaxis(estimators.partial(s), 0, -1)),
        frozen(np.moveaxis(estimators.multiple(s), 0, -1)),
        cross.averaging,
        tuple(cross.actuators[i] for i in moving),
        cross.sensors,
    )
