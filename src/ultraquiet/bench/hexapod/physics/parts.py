"""Everything one hexapod is made of: six struts that need not be alike, two bodies, and what is fixed to them."""

from dataclasses import dataclass, replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.bench.hexapod.physics.geometry import Joints, joints
from ultraquiet.bench.hexapod.physics.monitors import AXES, BODIES, PROOF_MASSES, TRIAXIAL_GAIN, ProofMass
from ultraquiet.bench.hexapod.physics.parameters import (
    BASES,
    GEOPHONE_HZ,
    PAYLOAD,
    STRUTS,
    Base,
    Body,
    Electronics,
    Geometry,
    Strut,
)

INSTRUMENTS = ("struts", "all")


@dataclass(frozen=True, eq=False)
class HexapodParts:
    """The parts of one bench.

    Args:
        base: what the struts stand on.
        payload: what they carry, platform included.
        at: the joints of the struts.
        height_m: from the plane of the base's joints to that of the platform's.
        struts: the six struts.
        lines: amplifier and conditioning of each strut; with all instruments, that of the axes of the base's and the
            payload's geophone after them (the same geophones: assumed).
        proof_masses: those of base and payload; none when they are held fast.
    """

    base: Base
    payload: Body
    at: Joints
    height_m: float
    struts: tuple[Strut, ...]
    lines: tuple[Electronics, ...]
    proof_masses: tuple[ProofMass, ...]

    @property
    def triaxial(self) -> bool:
        """Whether the geophones of base and payload are read."""
        return len(self.lines) > STRUTS

    @property
    def amplifiers_hz(self) -> FloatArray:
        """Corner of each actuator's drive in Hz, `(nu,)`."""
        stacks = [line.amplifier_hz for line in self.lines[:STRUTS]]
        return np.array(stacks + [p.drive_hz for p in self.proof_masses])

    def per_strut(self, name: str) -> FloatArray:
        """Return one number of `Strut` for each strut, `(6,)`."""
        return np.array([getattr(strut, name) for strut in self.struts])

    def per_line(self, name: str) -> FloatArray:
        """Return one number of `Electronics` for each sensor, `(ny,)`."""
        return np.array([getattr(line, name) for line in self.lines])


def nominal(unit: str, instruments: str, geophone_hz: float = GEOPHONE_HZ) -> HexapodParts:
    """Return the parts of a unit, as drawn; `geophone_hz` is the corner of the struts' geophones."""
    every = instruments == "all"
    lines = (Electronics(geophone_hz=geophone_hz),) * STRUTS
    if every:
        lines += (replace(Electronics(), gain=TRIAXIAL_GAIN),) * (len(BODIES) * len(AXES))
    proof_masses = PROOF_MASSES if every else ()
    geometry = Geometry()
    return HexapodParts(
        BASES[unit], PAYLOAD, joints(geometry), geometry.height_m, (Strut(),) * STRUTS, lines, proof_masses
    )
