"""Evidence on models: residual tests, fits on other records, agreement of frequency responses."""

from ultraquiet.validate.compare import BodeAgreement, Comparison, bode_agreement, compare
from ultraquiet.validate.predict import innovations, predicted, simulated
from ultraquiet.validate.residuals import ResidualTest, residual_test

__all__ = [
    "BodeAgreement",
    "Comparison",
    "ResidualTest",
    "bode_agreement",
    "compare",
    "innovations",
    "predicted",
    "residual_test",
    "simulated",
]
