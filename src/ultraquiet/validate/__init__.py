"""Evidence on models: residual tests, fits on other records, confidence, order choice, agreement of responses."""

from ultraquiet.validate.bands import ResponseBand, response_band
from ultraquiet.validate.compare import BodeAgreement, Comparison, bode_agreement, compare
from ultraquiet.validate.criteria import Selection, information_criteria, select
from ultraquiet.validate.predict import innovations, predicted, simulated
from ultraquiet.validate.residuals import ResidualTest, residual_test

__all__ = [
    "BodeAgreement",
    "Comparison",
    "ResidualTest",
    "ResponseBand",
    "Selection",
    "bode_agreement",
    "compare",
    "information_criteria",
    "innovations",
    "predicted",
    "residual_test",
    "response_band",
    "select",
    "simulated",
]
