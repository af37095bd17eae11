"""The wires of the bench: names and limits of its channels, and the noise on its readings."""

from collections.abc import Callable

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.bench.hexapod.laws import Limits
from ultraquiet.bench.hexapod.physics.monitors import AXES, BODIES
from ultraquiet.bench.hexapod.physics.parameters import STRUTS, Electronics
from ultraquiet.bench.hexapod.physics.parts import HexapodParts
from ultraquiet.values import Channel

_STRUTS = tuple(f"strut {i + 1}" for i in range(STRUTS))
ACTUATORS = _STRUTS + tuple(f"{body} proof mass" for body in BODIES)
SENSORS = _STRUTS + tuple(f"{body} {axis}" for body in BODIES for axis in AXES)


def channels(names: tuple[str, ...], limits_v: FloatArray) -> tuple[Channel, ...]:
    """Return as many of the named channels as there are limits."""
    return tuple(Channel(name, "V", -v, v) for name, v in zip(names, limits_v.tolist(), strict=False))


def limits(parts: HexapodParts, adc_bits: int | None, saturate: bool) -> Limits:
    """Return where commands, actuators and readings saturate; without `adc_bits` readings are not rounded."""
    e = Electronics()
    # The converter is used symmetrically: of its 2^bits codes the lowest stays unused, so both ends are +-10 V.
    step = e.reading_limit_v / (2 ** (adc_bits - 1) - 1) if adc_bits else 0.0
    proof_masses = [p.limit_v for p in parts.proof_masses]
    command = np.array([e.command_limit_v] * STRUTS + proof_masses)
    actuator = np.array([e.stack_high_v - e.bias_v] * STRUTS + proof_masses)
    reading = np.full(len(parts.lines), e.reading_limit_v)
    if not saturate:
        return Limits(np.inf * command, np.inf * actuator, np.inf * reading, step)
    return Limits(command, actuator, reading, step)


def noise(seed: int, run_index: int, sensors: int) -> Callable[[int], FloatArray]:
    """Return what draws the noise of a run, `(samples, sensors)` at a time.

    That of the struts is the same whatever other sensors there are.
    """
    keys = [((run_index,), STRUTS), ((run_index, 1), sensors - STRUTS)]
    draws = [(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key)), n) for key, n in keys]
    sigma = Electronics().noise_v
    return lambda samples: sigma * np.hstack([rng.standard_normal((samples, n)) for rng, n in draws])
