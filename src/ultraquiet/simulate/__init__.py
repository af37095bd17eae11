"""Room `simulate`: controllers on a bench, never on the model they were designed from.

May be changed here: how loops are run and what is measured of them. A bench is anything that keeps the contract of
`ultraquiet.bench`; a controller acts as u = K y.
"""

from ultraquiet._base.shown import show
from ultraquiet.simulate.attenuation import Attenuation, attenuation
from ultraquiet.simulate.campaign import campaign, drawn_benches
from ultraquiet.simulate.campaigns.drawing import drawn_bench, drawn_parameters
from ultraquiet.simulate.campaigns.evaluation import Campaign, Tuning
from ultraquiet.simulate.campaigns.run import is_of, run_campaign
from ultraquiet.simulate.commissioning.commission import Commissioning, CommissioningStep, commission
from ultraquiet.simulate.commissioning.tuning import Tuned, tune_in_place
from ultraquiet.simulate.loop import disturb
from ultraquiet.simulate.noise import NoiseReduction, noise_reduction
from ultraquiet.simulate.open_loop import OpenLoop
from ultraquiet.simulate.payload.measure import OpenPayload, PayloadVibration, measure_payload
from ultraquiet.simulate.payload.reduction import PayloadReduction
from ultraquiet.simulate.payload.setup import PayloadSetup
from ultraquiet.simulate.sensitivity.measure import measure_sensitivity
from ultraquiet.simulate.sensitivity.measured import MeasuredSensitivity
from ultraquiet.simulate.stability import LoopCheck, check_stability
from ultraquiet.simulate.step import StepReduction, step_reduction

__all__ = [
    "Attenuation",
    "Campaign",
    "Commissioning",
    "CommissioningStep",
    "LoopCheck",
    "MeasuredSensitivity",
    "NoiseReduction",
    "OpenLoop",
    "OpenPayload",
    "PayloadReduction",
    "PayloadSetup",
    "PayloadVibration",
    "StepReduction",
    "Tuned",
    "Tuning",
    "attenuation",
    "campaign",
    "check_stability",
    "commission",
    "disturb",
    "drawn_bench",
    "drawn_benches",
    "drawn_parameters",
    "is_of",
    "measure_payload",
    "measure_sensitivity",
    "noise_reduction",
    "run_campaign",
    "step_reduction",
    "tune_in_place",
]

show(globals(), __all__)
