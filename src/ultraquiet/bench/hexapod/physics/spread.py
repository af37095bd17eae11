"""How far one unit may differ from the drawing, and the draw of a unit."""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.bench.hexapod.physics.geometry import Joints
from ultraquiet.bench.hexapod.physics.monitors import ProofMass
from ultraquiet.bench.hexapod.physics.parameters import STRUTS, Base, Body, Electronics, Strut
from ultraquiet.bench.hexapod.physics.parts import HexapodParts

# Each number lies evenly within plus or minus this share of the drawing's. "Data sheets" are the usual figures of the
# trade for such parts, not SUITE's own; the paper states none.
STRUT_SHARES = {
    "stack_stiffness_n_per_m": 0.05,  # assumed; data sheets of stacks say 20 % of the whole, a matched set is closer
    "foot_m_per_n": 0.10,  # assumed
    "moving_mass_kg": 0.02,  # assumed: machined parts, glue and cable
    "stack_damping": 0.30,  # assumed
    "free_stroke_m_per_v": 0.10,  # data sheets of stacks: 10 to 20 %
    "stage_stiffness_n_per_m": 0.10,  # assumed: a viscoelastic batch
    "stage_loss": 0.10,  # assumed, likewise
}
LINE_SHARES = {
    "amplifier_hz": 0.10,  # data sheets: capacitance of a stack within 10 to 20 %
    "geophone_hz": 0.05,  # data sheets of geophones: 2.5 to 5 %
    "geophone_damping": 0.05,  # data sheets of geophones: 5 %
    "geophone_v_per_m_s": 0.05,  # data sheets of geophones: 2.5 to 5 %
    "gain": 0.01,  # 1 % resistors
    "filter_hz": 0.02,  # 1 % resistors and capacitors
    "filter_damping": 0.02,
}
PROOF_MASS_SHARES = {
    "moving_mass_kg": 0.02,  # assumed, all of them
    "suspension_hz": 0.05,
    "suspension_damping": 0.30,
    "newton_per_v": 0.05,
    "drive_hz": 0.05,
}
MASS_SHARE = 0.01  # of a body, assumed: weighed, but cables and fasteners change
INERTIA_SHARE = 0.05  # of each principal inertia of a body, assumed: computed, not measured
CENTRE_M = 0.002  # of a body's centre of mass in each direction, assumed
JOINT_M = 0.0005  # of each joint in each direction, assumed: machining and assembly
MOUNT_SHARES = {"mount_hz": 0.10, "mount_damping": 0.30}  # assumed

Part = TypeVar("Part", Strut, Electronics, ProofMass, Base)


def draw(parts: HexapodParts, spread: float, unit_seed: int) -> HexapodParts:
    """Return the parts of one unit: every number drawn evenly within `spread` times its tolerance.

    The same seed draws the same struts whatever instruments stand beside them, and deviations grow with `spread`.

    Args:
        parts: as drawn, see `parts.nominal`.
        spread: 0 leaves the parts as they are, 1 uses the tolerances of this file.
        unit_seed: which unit.
    """
    if spread == 0.0:
        return parts
    rng = np.random.default_rng(np.random.SeedSequence(unit_seed))

    def even(*shape: int) -> FloatArray:
        return spread * rng.uniform(-1.0, 1.0, shape)

    def varied(part: Part, shares: dict[str, float]) -> Part:
        by = even(len(shares))
        changed = {name: getattr(part, name) * (1.0 + s * v) for (name, s), v in zip(shares.items(), by, strict=True)}
        return replace(part, **changed)

    struts = tuple(varied(strut, STRUT_SHARES) for strut in parts.struts)
    at = Joints(parts.at.base + JOINT_M * even(STRUTS, 3), parts.at.platform + JOINT_M * even(STRUTS, 3))
    payload = _body(parts.payload, even(6))
    body = parts.base.body
    base: Base = varied(replace(parts.base, body=None if body is None else _body(body, even(6))), MOUNT_SHARES)
    lines = tuple(varied(line, LINE_SHARES) for line in parts.lines)
    proof_masses = tuple(varied(p, PROOF_MASS_SHARES) for p in parts.proof_masses)
    return HexapodParts(base, payload, at, parts.height_m, struts, lines, proof_masses)


def _body(body: Body, by: FloatArray) -> Body:
    """Return a body with its mass, inertias, and centre varied; `by` has their six deviations but the third's spare."""
    x, y, z = (float(i * (1.0 + INERTIA_SHARE * v)) for i, v in zip(body.inertia_kg_m2, by[1:4], strict=True))
    aside = (body.aside_m[0] + CENTRE_M * float(by[4]), body.aside_m[1] + CENTRE_M * float(by[5]))
    return Body(body.mass_kg * (1.0 + MASS_SHARE * float(by[0])), (x, y, z), body.centre_m, aside)


def told(parts: HexapodParts) -> dict[str, float]:
    """Return the numbers of a unit by name: of its struts and lines the mean and the widest difference, of bodies all.

    The struts act together, so their mean is what moves a mode, and their difference what breaks the symmetry.
    """
    found: dict[str, float] = {}
    for shares, of in ((STRUT_SHARES, parts.per_strut), (LINE_SHARES, parts.per_line)):
        for name in shares:
            values = of(name)[:STRUTS]
            found[f"{name}, mean"], found[f"{name}, range"] = float(values.mean()), float(np.ptp(values))
    bodies = {"payload": parts.payload, **({} if parts.base.body is None else {"base": parts.base.body})}
    for name, body in bodies.items():
        found[f"{name} mass_kg"], found[f"{name} centre_m"] = body.mass_kg, float(np.hypot(*body.aside_m))
        found |= {f"{name} inertia_{axis}": i for axis, i in zip("xyz", body.inertia_kg_m2, strict=True)}
    if parts.base.body is not None and parts.base.mount_hz:
        found |= {name: float(getattr(parts.base, name)) for name in MOUNT_SHARES}
    return found
