"""What flows through a study: immutable values that know nothing of the methods that make or use them."""

from ultraquiet._base.shown import show
from ultraquiet.values.blended.blending import Blending
from ultraquiet.values.channel import Channel
from ultraquiet.values.controller import Controller, SteppedController
from ultraquiet.values.decimation import Decimation
from ultraquiet.values.frequency_response import FrequencyResponse
from ultraquiet.values.innovation_form import InnovationForm
from ultraquiet.values.polynomial import PolynomialMatrix, PolynomialModel
from ultraquiet.values.record import Record
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

__all__ = [
    "Blending",
    "Channel",
    "Controller",
    "Decimation",
    "FrequencyResponse",
    "InnovationForm",
    "PolynomialMatrix",
    "PolynomialModel",
    "Record",
    "StateSpace",
    "Status",
    "StatusWord",
    "SteppedController",
]

show(globals(), __all__)
