"""Spectra of records: densities, frequency responses, coherence, transmissibility, bands and vibration criteria.

May be changed here: how spectra are estimated. Every result says its window, averages, overlap and resolution.
"""

from ultraquiet._base.shown import show
from ultraquiet.spectra.averaging import Averaging
from ultraquiet.spectra.bands import BandLevels, Bands, band_levels, filtered_levels, octave_bands
from ultraquiet.spectra.best_linear import BestLinear, best_linear
from ultraquiet.spectra.coherence import Coherence, coherence
from ultraquiet.spectra.criteria import CRITERIA, Classification, Criterion, classify, criterion
from ultraquiet.spectra.cross import CrossSpectra, cross_spectra
from ultraquiet.spectra.detection import Detection
from ultraquiet.spectra.frf import frf
from ultraquiet.spectra.given import with_coherence_variance
from ultraquiet.spectra.local_polynomial import LocalPolynomial, local_polynomial
from ultraquiet.spectra.motion import convert_response, convert_spectrum
from ultraquiet.spectra.periodic import periodic_response
from ultraquiet.spectra.psd import PowerSpectrum, psd
from ultraquiet.spectra.transmissibility import Transmissibility, magnitude_error, transmissibility

__all__ = [
    "CRITERIA",
    "Averaging",
    "BandLevels",
    "Bands",
    "BestLinear",
    "Classification",
    "Coherence",
    "Criterion",
    "CrossSpectra",
    "Detection",
    "LocalPolynomial",
    "PowerSpectrum",
    "Transmissibility",
    "band_levels",
    "best_linear",
    "classify",
    "coherence",
    "convert_response",
    "convert_spectrum",
    "criterion",
    "cross_spectra",
    "filtered_levels",
    "frf",
    "local_polynomial",
    "magnitude_error",
    "octave_bands",
    "periodic_response",
    "psd",
    "transmissibility",
    "with_coherence_variance",
]

show(globals(), __all__)
