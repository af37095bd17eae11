"""Controllers from plants: settings objects with one verb, `design`, and the synthesis for a generalised plant."""

from ultraquiet._base.shown import show
from ultraquiet.design.decoupling.decoupled import Decoupled, threefold
from ultraquiet.design.decoupling.modal import Modal
from ultraquiet.design.fixed_structure.classical import LeadLag, Notch
from ultraquiet.design.fixed_structure.method import FixedStructure
from ultraquiet.design.fixed_structure.skyhook import Skyhook
from ultraquiet.design.fixed_structure.specification import Score, Specification
from ultraquiet.design.fixed_structure.synthesis import synthesize_structured
from ultraquiet.design.h2.lqg import Lqg
from ultraquiet.design.h2.synthesis import synthesize_h2
from ultraquiet.design.hinf.band_attenuation import BandAttenuation, common_mode, worst_attenuation_db
from ultraquiet.design.hinf.loop_shaping import LoopShaping
from ultraquiet.design.hinf.mixed_sensitivity import MixedSensitivity
from ultraquiet.design.hinf.synthesis import synthesize_hinf
from ultraquiet.design.hinf.verification import Opinion, verify_level
from ultraquiet.design.mu.dk_iteration import MuSynthesis
from ultraquiet.design.peak_bounded.method import PeakBounded
from ultraquiet.design.result import DesignMethod, DesignResult
from ultraquiet.design.tones.adaptive_feedforward import AdaptiveFeedforward
from ultraquiet.design.tones.filtered_x_lms import FilteredXLms
from ultraquiet.design.tones.resonators import Resonators
from ultraquiet.design.tones.youla_kucera import YoulaKucera
from ultraquiet.design.weights.filters import band_pass, high_pass, peak
from ultraquiet.values.generalised import four_block, output_shaping

__all__ = [
    "AdaptiveFeedforward",
    "BandAttenuation",
    "Decoupled",
    "DesignMethod",
    "DesignResult",
    "FilteredXLms",
    "FixedStructure",
    "LeadLag",
    "LoopShaping",
    "Lqg",
    "MixedSensitivity",
    "Modal",
    "MuSynthesis",
    "Notch",
    "Opinion",
    "PeakBounded",
    "Resonators",
    "Score",
    "Skyhook",
    "Specification",
    "YoulaKucera",
    "band_pass",
    "common_mode",
    "four_block",
    "high_pass",
    "output_shaping",
    "peak",
    "synthesize_h2",
    "synthesize_hinf",
    "synthesize_structured",
    "threefold",
    "verify_level",
    "worst_attenuation_db",
]

show(globals(), __all__)
