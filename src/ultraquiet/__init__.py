"""Ultraquiet: from the first excitation of a vibration-isolation bench to verified controller code.

>>> import ultraquiet as uq
>>> uq.signals.Chirp(start_hz=5, stop_hz=100).generate(samples=4096, rate_hz=3500.0).shape
(4096,)
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ultraquiet import analyse as analyse
    from ultraquiet import bench as bench
    from ultraquiet import deploy as deploy
    from ultraquiet import design as design
    from ultraquiet import experiments as experiments
    from ultraquiet import files as files
    from ultraquiet import identify as identify
    from ultraquiet import limits as limits
    from ultraquiet import plot as plot
    from ultraquiet import reduce as reduce
    from ultraquiet import report as report
    from ultraquiet import signals as signals
    from ultraquiet import simulate as simulate
    from ultraquiet import spectra as spectra
    from ultraquiet import validate as validate
    from ultraquiet._base import errors as errors
    from ultraquiet.values import Channel as Channel
    from ultraquiet.values import FrequencyResponse as FrequencyResponse
    from ultraquiet.values import InnovationForm as InnovationForm
    from ultraquiet.values import PolynomialMatrix as PolynomialMatrix
    from ultraquiet.values import PolynomialModel as PolynomialModel
    from ultraquiet.values import Record as Record
    from ultraquiet.values import StateSpace as StateSpace

    __version__: str

__all__ = [
    "Channel",
    "FrequencyResponse",
    "InnovationForm",
    "PolynomialMatrix",
    "PolynomialModel",
    "Record",
    "StateSpace",
    "analyse",
    "bench",
    "deploy",
    "design",
    "errors",
    "experiments",
    "files",
    "identify",
    "limits",
    "plot",
    "reduce",
    "report",
    "signals",
    "simulate",
    "spectra",
    "validate",
]

_VALUES = (
    "Channel",
    "FrequencyResponse",
    "InnovationForm",
    "PolynomialMatrix",
    "PolynomialModel",
    "Record",
    "StateSpace",
)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("ultraquiet._base.provenance").versions()["ultraquiet"]
    if name not in __all__:
        raise AttributeError(f"module 'ultraquiet' has no attribute {name!r}")
    if name in _VALUES:
        return getattr(importlib.import_module("ultraquiet.values"), name)
    if name == "errors":
        return importlib.import_module("ultraquiet._base.errors")
    return importlib.import_module(f"ultraquiet.{name}")


def __dir__() -> list[str]:
    return list(__all__)
