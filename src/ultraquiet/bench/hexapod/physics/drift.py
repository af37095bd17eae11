"""How the bench's temperature moves, and what it moves."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from ultraquiet.bench.hexapod.physics.parameters import Electronics, Strut
from ultraquiet.bench.hexapod.physics.parts import HexapodParts

REFERENCE_C = 20.0  # where the parts are as drawn
# Cycles of the temperature: period in seconds and amplitude in kelvin at a drift of 1, all assumed. A low orbit takes
# 97 minutes; a laboratory has its air conditioning and the day.
CYCLES: dict[str, tuple[tuple[float, float], ...]] = {
    "flight": ((5820.0, 5.0),),
    "ground": ((1200.0, 0.5), (86400.0, 2.0)),
    "rigid": ((1200.0, 0.5), (86400.0, 2.0)),
}
RUN_EVERY_S = 60.0  # from the start of one run to that of the next: the run and the time to save it
RENEWED_EVERY_S = 1.0  # within which no temperature above moves by more than 6 mK

# Share by which a number grows per kelvin; typical of such materials, assumed.
PER_KELVIN_STRUT = {
    "stage_stiffness_n_per_m": -0.010,  # viscoelastic layers soften: 1 to 3 %
    "stage_loss": 0.005,
    "free_stroke_m_per_v": 0.002,  # soft piezo ceramics: 0.1 to 0.3 %
}
PER_KELVIN_LINE = {
    "amplifier_hz": -0.004,  # the capacitance of soft piezo ceramics grows by 0.4 %
    "geophone_v_per_m_s": -0.0005,  # magnets weaken
}
_WEATHER = 1  # keeps these draws apart from those of noise

Part = TypeVar("Part", Strut, Electronics)


def weather(unit: str, seed: int, drift: float) -> Callable[[float], float]:
    """Return the temperature in degrees Celsius as a function of the bench's clock in seconds.

    T(t) = 20 + drift sum_i a_i sin(2 pi t / P_i + phi_i), the phases drawn from `seed`.

    >>> weather("flight", 0, 0.0)(1234.5)
    20.0
    """
    rng = np.random.default_rng(np.random.SeedSequence((seed, _WEATHER)))
    waves = [(2.0 * np.pi / period, kelvin, rng.uniform(0.0, 2.0 * np.pi)) for period, kelvin in CYCLES[unit]]
    return lambda t: REFERENCE_C + drift * float(sum(a * np.sin(w * t + phase) for w, a, phase in waves))


def at_temperature(parts: HexapodParts, temperature_c: float) -> HexapodParts:
    """Return the parts at a temperature, all of them at the same; those known at REFERENCE_C are given.

    What a driven stack warms by itself is left out.
    """
    warmer = temperature_c - REFERENCE_C
    if warmer == 0.0:
        return parts

    def moved(part: Part, per_kelvin: dict[str, float]) -> Part:
        changed = {name: getattr(part, name) * (1.0 + share * warmer) for name, share in per_kelvin.items()}
        return replace(part, **changed)

    struts = tuple(moved(strut, PER_KELVIN_STRUT) for strut in parts.struts)
    return replace(parts, struts=struts, lines=tuple(moved(line, PER_KELVIN_LINE) for line in parts.lines))
