"""A hexapod of other geometry, masses, modes, noise and hysteresis than the packaged bench's, drawn by a seed."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ultraquiet.bench import Hexapod
from ultraquiet.bench.columns import spanned, turned
from ultraquiet.bench.hexapod.model import Model
from ultraquiet.bench.hexapod.physics.geometry import joints
from ultraquiet.bench.hexapod.physics.hysteresis import typical
from ultraquiet.bench.hexapod.physics.parameters import Body, Geometry
from ultraquiet.bench.hexapod.physics.parts import nominal
from ultraquiet.bench.hexapod.physics.spread import draw

APART = 0.0005  # kept of a unit's own tolerances, so that no two struts are alike


@dataclass(frozen=True)
class OtherHexapod(Hexapod):
    """Another hexapod: `geometry_seed` draws plates, bodies, stages, stacks, amplifiers, noise and hysteresis."""

    geometry_seed: int = 0

    @property
    def model(self):
        return other_model(self.unit, self.instruments, self.geometry_seed, self.unit_seed)

    def _matrices(self, temperature_c):
        A, B, C = self.model.stepped_at(temperature_c)
        plays, rng = typical(), np.random.default_rng([self.geometry_seed, 1])
        weights = plays.weights.copy()
        weights[1:] *= rng.uniform(0.5, 1.3)
        weights[0] += plays.weights.sum() - weights.sum()
        return spanned(A), spanned(B), turned(C), plays.thresholds_v * rng.uniform(0.7, 1.4), weights

    def _noise(self, index):
        draws = super()._noise(index)
        louder = np.random.default_rng([self.geometry_seed, 2]).uniform(0.5, 2.0)
        return lambda samples: louder * draws(samples)


@lru_cache(maxsize=8)
def other_model(unit, instruments, geometry_seed, unit_seed):
    """Return the model of a unit; ground and flight carry the same struts and payload."""
    rng = np.random.default_rng([geometry_seed, 0])

    def by(low, high, value=1.0):
        return float(value * rng.uniform(low, high))

    geometry = Geometry(
        by(0.75, 1.3, 0.160), by(0.75, 1.3, 0.145), by(0.8, 1.35, 0.084), by(0.6, 1.6, 8.5), by(0.6, 1.6, 9.0)
    )
    parts = nominal(unit, instruments)
    heavier = by(0.7, 1.4)
    inertia = tuple(heavier * by(0.75, 1.35, each) for each in parts.payload.inertia_kg_m2)
    payload = Body(heavier * parts.payload.mass_kg, inertia, by(0.5, 1.5, parts.payload.centre_m))
    strut = replace(
        parts.struts[0],
        stack_stiffness_n_per_m=by(0.8, 1.25, parts.struts[0].stack_stiffness_n_per_m),
        moving_mass_kg=by(0.85, 1.2, parts.struts[0].moving_mass_kg),
        stage_stiffness_n_per_m=by(0.6, 1.6, parts.struts[0].stage_stiffness_n_per_m),
        stage_loss=by(0.7, 1.4, parts.struts[0].stage_loss),
    )
    corner, damping, gain = by(0.8, 1.25), by(0.85, 1.15), by(0.7, 1.4)
    lines = tuple(
        replace(line, amplifier_hz=corner * line.amplifier_hz, geophone_damping=damping * line.geophone_damping,
                gain=gain * line.gain) for line in parts.lines
    )  # fmt: skip
    base, body = parts.base, parts.base.body
    larger = by(0.6, 1.6)
    if body is not None:
        body = Body(
            larger * body.mass_kg, tuple(larger * by(0.8, 1.25, each) for each in body.inertia_kg_m2), body.centre_m
        )
    base = replace(
        base, body=body, mount_hz=by(0.75, 1.2, base.mount_hz), mount_damping=by(0.7, 1.5, base.mount_damping)
    )
    other = replace(parts, base=base, payload=payload, at=joints(geometry), height_m=geometry.height_m,
                    struts=(strut,) * len(parts.struts), lines=lines)  # fmt: skip
    return Model(draw(other, APART, unit_seed))
