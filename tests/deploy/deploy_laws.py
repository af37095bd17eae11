"""Random control laws of the kind the bench gets: lightly damped modes between 0.5 and 400 Hz, mixed coordinates."""

import numpy as np
from scipy.linalg import block_diag, qr

from ultraquiet._base.errors import InputError
from ultraquiet.deploy import fixed_law, generate_fixed
from ultraquiet.values import StateSpace

RATE_HZ = 3500.0
TRIES = 10  # laws drawn for whole numbers: far more than one in ten is held
RANGES = {"input_v": 10.0, "output_v": 25.0}  # of whole numbers, where no channel states one


def block(pole):
    return np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])


def law_in_words(rng, word, states, inputs=6, outputs=6, quiet=1.0, drowned=True, **settings):
    """The first law drawn that whole numbers of a word's length hold, also `quiet` times as loud.

    Without `drowned`, one in which neither's rounding fills the range of the commands.
    """
    for _ in range(TRIES):
        law = random_law(rng, states, inputs, outputs)
        soft = StateSpace(law.A, law.B, quiet * law.C, quiet * law.D, rate_hz=RATE_HZ)
        try:
            fixed = [fixed_law(each, word, **RANGES, **settings) for each in (law, soft)]
        except InputError:  # a row that sums to too much, a pole too near the circle for its coefficients
            continue
        if drowned or all(each.noise_v.max() < each.output_v for each in fixed):
            return law
    raise AssertionError(f"{word} holds none of {TRIES} drawn laws")


def code_in_words(rng, folder, word, states, inputs, outputs, loud=1.0, ramp_s=0.5, **settings):
    """The code of the first law drawn that a word's length holds and does not drown in its own rounding."""
    for _ in range(TRIES):
        law = law_in_words(rng, word, states, inputs, outputs, quiet=loud, **settings)
        law = StateSpace(law.A, law.B, loud * law.C, loud * law.D, rate_hz=RATE_HZ)
        try:
            return generate_fixed(law, folder, word, tolerance=1.0, ramp_s=ramp_s, **settings, **RANGES)
        except InputError:
            continue
    raise AssertionError(f"{word} drowns {TRIES} drawn laws")


def random_law(rng, states, inputs=6, outputs=6, mixed=True):
    f_hz = np.exp(rng.uniform(np.log(0.5), np.log(400.0), states // 2))
    damping = 10 ** rng.uniform(-2.5, -0.2, states // 2)
    s = 2 * np.pi * f_hz * (-damping + 1j * np.sqrt(1 - damping**2))
    blocks = [block(p) for p in np.exp(s / RATE_HZ)]
    if states % 2:
        blocks.append(np.array([[rng.uniform(0.5, 0.999)]]))
    A = block_diag(*blocks) if blocks else np.zeros((0, 0))
    T = qr(rng.standard_normal((states, states)))[0] if mixed and states else np.eye(states)
    size = 0.3 / np.sqrt(max(states, 1))
    B = T @ (size * rng.standard_normal((states, inputs)))
    C = (size * rng.standard_normal((outputs, states))) @ T.T
    return StateSpace(T @ A @ T.T, B, C, 0.2 * rng.standard_normal((outputs, inputs)), rate_hz=RATE_HZ)
