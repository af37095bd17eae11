"""Spectra of records: power spectral densities and frequency responses with their coherence."""

from ultraquiet.spectra.frf import frf
from ultraquiet.spectra.periodic import periodic_response
from ultraquiet.spectra.psd import PowerSpectrum, psd

__all__ = ["PowerSpectrum", "frf", "periodic_response", "psd"]
