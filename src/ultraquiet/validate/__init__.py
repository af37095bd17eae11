"""Evidence on models: residual tests, fits on other records, confidence, order choice, agreement of responses."""

from ultraquiet._base.shown import show
from ultraquiet.validate.advice.advise import Advice, advise
from ultraquiet.validate.bands import ResponseBand, response_band
from ultraquiet.validate.compare import BodeAgreement, Comparison, bode_agreement, compare
from ultraquiet.validate.criteria import Selection, information_criteria, select
from ultraquiet.validate.draws import drawn_plants
from ultraquiet.validate.predict import innovations, predicted, simulated
from ultraquiet.validate.residuals import ResidualTest, residual_test
from ultraquiet.validate.state_space_bands import state_space_band
from ultraquiet.validate.state_space_tests import state_space_test
from ultraquiet.validate.uncertainty import Uncertainty, UncertaintyWeight, combined, from_covariance, from_spread
from ultraquiet.validate.verdict import verdict

__all__ = [
    "Advice",
    "BodeAgreement",
    "Comparison",
    "ResidualTest",
    "ResponseBand",
    "Selection",
    "Uncertainty",
    "UncertaintyWeight",
    "advise",
    "bode_agreement",
    "combined",
    "compare",
    "drawn_plants",
    "from_covariance",
    "from_spread",
    "information_criteria",
    "innovations",
    "predicted",
    "residual_test",
    "response_band",
    "select",
    "simulated",
    "state_space_band",
    "state_space_test",
    "verdict",
]

show(globals(), __all__)
