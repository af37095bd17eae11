"""Models from records: polynomial structures by prediction error, state space by subspaces, whole transfer matrices.

Importing the room registers its methods; the compiled kernels are loaded by the first identification.
"""

from ultraquiet._base.shown import show
from ultraquiet.identify.grey_box.modal import StructuredModal
from ultraquiet.identify.grey_box.modal_result import ModalFit
from ultraquiet.identify.grey_box.strut import Structured
from ultraquiet.identify.grey_box.strut_result import StructuredFit
from ultraquiet.identify.grey_box.threefold import Folded, Threefold, ThreefoldFit, fold
from ultraquiet.identify.health.channels import Health, channel_health
from ultraquiet.identify.joint.identify import identify_joint
from ultraquiet.identify.polynomial.matrix import MatrixResult, identify_matrix
from ultraquiet.identify.polynomial.methods import Armax, Arx, BoxJenkins, OutputError
from ultraquiet.identify.polynomial.order_selection import Candidate, Sweep, sweep
from ultraquiet.identify.recursive.estimator import Recursion
from ultraquiet.identify.recursive.methods import (
    RecursiveArmax,
    RecursiveArx,
    RecursiveBoxJenkins,
    RecursiveOutputError,
)
from ultraquiet.identify.recursive.trajectory import Trajectory
from ultraquiet.identify.regularised.arx import RegularisedArx
from ultraquiet.identify.regularised.impulse_response import ImpulseResponse
from ultraquiet.identify.regularised.posterior import ResponseResult
from ultraquiet.identify.response.model import Band, WeightedFit
from ultraquiet.identify.response.rational import Rational, ResponseFit
from ultraquiet.identify.response.weighted_rational import WeightedRational
from ultraquiet.identify.result import Identification, Result
from ultraquiet.identify.subspace.method import Subspace
from ultraquiet.identify.subspace.one_step.predictor import PredictorSubspace

__all__ = [
    "Armax",
    "Arx",
    "Band",
    "BoxJenkins",
    "Candidate",
    "Folded",
    "Health",
    "Identification",
    "ImpulseResponse",
    "MatrixResult",
    "ModalFit",
    "OutputError",
    "PredictorSubspace",
    "Rational",
    "Recursion",
    "RecursiveArmax",
    "RecursiveArx",
    "RecursiveBoxJenkins",
    "RecursiveOutputError",
    "RegularisedArx",
    "ResponseFit",
    "ResponseResult",
    "Result",
    "Structured",
    "StructuredFit",
    "StructuredModal",
    "Subspace",
    "Sweep",
    "Threefold",
    "ThreefoldFit",
    "Trajectory",
    "WeightedFit",
    "WeightedRational",
    "channel_health",
    "fold",
    "identify_joint",
    "identify_matrix",
    "sweep",
]

show(globals(), __all__)
