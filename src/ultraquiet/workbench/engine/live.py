"""What a loop is while a hand moves something: S, T, KS and disk margins from frequency responses, no synthesis.

S = (I - L)^-1 with L = G K at the outputs, K G at the inputs; T = S - I; KS = K S. The disk margin of all channels at
once is stated from below, alpha = 1 / max over f of sigma(S - I / 2): the largest singular value is never less than mu.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.design.worst_direction import scales_of
from ultraquiet.linalg.response import principal_gains
from ultraquiet.values import StateSpace
from ultraquiet.values.channel import ratio

POINTS = 300
NYQUIST_SHARE = 0.98


@dataclass(frozen=True, eq=False)
class Notched:
    """What a hand has turned on a law: a gain in dB, notches as (frequency in Hz, damping, depth in dB)."""

    gain_db: float = 0.0
    notches: Sequence[tuple[float, float, float]] = ()

    def response(self, f_hz: FloatArray) -> ComplexArray:
        """Return the factor on every channel of the law, `(nf,)`.

        g prod (s^2 + 2 z d w s + w^2) / (s^2 + 2 z w s + w^2), d the depth as a factor.
        """
        s = 1j * f_hz
        factor = np.full(f_hz.size, 10 ** (self.gain_db / 20), dtype=complex)
        for at, zeta, depth_db in self.notches:
            d = 10 ** (-depth_db / 20)
            factor = factor * (s**2 + 2 * zeta * d * at * s + at**2) / (s**2 + 2 * zeta * at * s + at**2)
        return factor


@dataclass(frozen=True, eq=False)
class LiveLoop:
    """Responses `(., ., nf)` of a loop and its margins from below, at both ends.

    `S` is taken over the directions that the inputs reach, as `analyse.band_attenuation` takes it.
    """

    f_hz: FloatArray
    S: ComplexArray
    T: ComplexArray
    KS: ComplexArray
    disk: Mapping[str, float]
    channels: Mapping[str, FloatArray]
    peak_db: float
    peak_hz: float


def grid_hz(plant: StateSpace, points: int = POINTS) -> FloatArray:
    """Return the frequencies at which loops are looked at: logarithmic, with the plant's own resonances."""
    assert plant.rate_hz is not None
    top = NYQUIST_SHARE * plant.rate_hz / 2
    poles = plant.poles()
    with np.errstate(divide="ignore"):
        own = np.abs(np.log(poles[np.abs(poles) > 0])) * plant.rate_hz / (2 * np.pi)
    own = own[(own > top / 1e5) & (own < top)]
    bottom = max(top / 1e5, min(own.min(initial=top), top / 100) / 10)
    around = (own[:, None] * np.array([0.97, 0.99, 1.0, 1.01, 1.03])).ravel()
    base = np.geomspace(bottom, top, points)
    return np.unique(np.concatenate([base, around[(around > bottom) & (around < top)]]))


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses of a plant `(ny, nu, nf)` and a law `(nu, ny, nf)`, an end of mixed units in the plant's own scales."""

    f_hz: FloatArray
    G: ComplexArray
    K: ComplexArray
    unit: str


def responses(plant: StateSpace, law: StateSpace) -> Responses:
    """Return the responses from which a loop is looked at; scales as in `design.loop_analysis.analyse_loop`."""
    f = grid_hz(plant)
    G, K = plant.frequency_response(f), law.frequency_response(f)
    if all(len({c.unit for c in wires}) == 1 for wires in (plant.actuators, plant.sensors)):
        return Responses(f, G, K, ratio(plant.actuators[0].unit, plant.sensors[0].unit))
    own = even_plant(plant, who="workbench")
    scales = scales_of(plant, own.inputs, own.outputs)
    y, u = scales.outputs[:, None, None], scales.inputs[:, None, None]
    return Responses(f, G * y * u.transpose(1, 0, 2), K / y.transpose(1, 0, 2) / u, "")


def attenuation_db(loop: "LiveLoop", band_hz: tuple[float, float]) -> float:
    """Return by how much the worst direction is quieter over a band, dB."""
    inside = (loop.f_hz >= band_hz[0]) & (loop.f_hz <= band_hz[1])
    if not inside.any():
        return float("nan")
    sizes = principal_gains(loop.S[:, :, inside])[0]
    return -20 * float(np.log10(sizes.max()))


def live_loop(G: ComplexArray, K: ComplexArray, f_hz: FloatArray, hand: Notched | None = None) -> LiveLoop:
    """Return the loop of a plant `(ny, nu, nf)` and a law `(nu, ny, nf)`, with what a hand has turned."""
    g, k = np.moveaxis(G, 2, 0), np.moveaxis(K, 2, 0)
    if hand is not None:
        k = k * hand.response(f_hz)[:, None, None]
    ny, nu = g.shape[1:]
    So: Any = np.linalg.inv(np.eye(ny) - g @ k)
    Si: Any = np.linalg.inv(np.eye(nu) - k @ g)
    disk = {end: _least(S) for end, S in (("input", Si), ("output", So))}
    channels = {end: _each(S) for end, S in (("input", Si), ("output", So))}
    # with more outputs than inputs, no law attenuates the directions that the inputs do not reach
    reached: Any = So @ np.linalg.qr(g)[0] if ny > nu else So
    sizes = np.linalg.svd(reached, compute_uv=False)[:, 0]
    at = int(np.argmax(sizes))
    back: list[Any] = [np.moveaxis(x, 0, 2) for x in (reached, So - np.eye(ny), k @ So)]
    peak_db = 20 * float(np.log10(sizes[at]))
    return LiveLoop(f_hz, back[0], back[1], back[2], disk, channels, peak_db, float(f_hz[at]))


def weight_bound(settings: Mapping[str, Any], f_hz: FloatArray) -> FloatArray | None:
    """Return 1 / |W1| of a band's weight, what S is pressed under; None where the settings give no band.

    W1 is high between the corners and at its floor elsewhere, with slopes of its order.
    """
    band = settings.get("band_hz")
    if not band:
        return None
    low, high = band
    height = settings.get("height") or 12.0
    floor = settings.get("floor") or 0.6
    order = max(1, int(settings.get("order") or 8) // 2)
    inside = 1 / np.sqrt((1 + (low / f_hz) ** (2 * order)) * (1 + (f_hz / high) ** (2 * order)))
    return 1 / np.maximum(height * inside, floor)


def _least(S: ComplexArray) -> float:
    eye = np.eye(S.shape[1]) / 2
    return 1 / float(np.linalg.svd(S - eye, compute_uv=False)[:, 0].max())


def _each(S: ComplexArray) -> FloatArray:
    own = np.abs(np.diagonal(S, axis1=1, axis2=2) - 0.5)
    return 1 / own.max(axis=0)
