"""Laws of few states a strut on the bench's true linear model, the H-infinity laws they are measured against beside."""

from collections.abc import Iterator

import ultraquiet as uq
from ultraquiet.design import BandAttenuation, Decoupled, FixedStructure, LeadLag, Skyhook, Specification

WANTED = Specification(band_hz=(10.0, 100.0), attenuation_db=12.0, peak_db=8.0)
SECTIONS = {
    "low_pass_hz": 3.0,
    "high_pass_hz": 1.0,
    "zeros_hz": (20.0, 80.0, 200.0),
    "poles_hz": (15.0, 70.0, 800.0),
    "notches_hz": (40.0, 300.0),
    "notch_zetas": (0.3, 0.2),
    "notch_widths": (0.6, 0.5),
}
METHODS = {
    "H-infinity, one law of 23 states": BandAttenuation(band_hz=(9.0, 108.0), structure="repeated"),
    "decoupled, threefold": Decoupled(transform="threefold"),
    "fixed structure, 8 states a strut": FixedStructure(states=8, specification=WANTED),
    "fixed structure, 12 states a strut": FixedStructure(states=12, specification=WANTED),
    "lead-lag and notches, 9 states a strut, tuned": LeadLag(tune=True, specification=WANTED, **SECTIONS),
    "skyhook, tuned": Skyhook(geophone_hz=12.0, geophone_zeta=0.65, low_pass_hz=250.0, tune=True, specification=WANTED),
}
TARGETS = {"fixed structure, 8 states a strut", "fixed structure, 12 states a strut"}


def measure() -> Iterator[tuple[str, str, str, bool]]:
    """Yield (what, measured, target, kept)."""
    plants = {unit: uq.bench.Hexapod(unit=unit).linear_model() for unit in ("ground", "flight")}
    for name, method in METHODS.items():
        law = method.design(plants["ground"]).controller
        assert law is not None
        for unit, plant in plants.items():
            score = WANTED.score(plant, law)
            got = score.measured
            told = f"{got['attenuation_db']:.1f} dB, peak {got['peak_db']:.1f} dB, |KS| {got['control_gain']:.0f}"
            judged = name in TARGETS and unit == "ground"
            yield f"{name}, {unit}", told, "12 dB at 8 dB" if judged else "-", score.met if judged else score.stable
