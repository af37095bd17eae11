"""Instruments beside the struts: proof-mass actuators and tri-axial geophones on base and payload."""

import math
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray

BODIES = ("base", "payload")
AXES = ("x", "y", "z")
TILT_DEG = 5.0  # section 2.1: the inclination of both tri-axial geophones to +Z
# Assumed; half of the struts' conditioning, so that a chirp of 25 V through one strut, which shakes the payload at its
# modes, stays within the converter's range.
TRIAXIAL_GAIN = 50.0
TILT_AZIMUTH_DEG = 30.0  # assumed: towards which side they lean, no plane of symmetry


@dataclass(frozen=True)
class ProofMass:
    """A mass on a spring, pushed along +Z by a coil that pushes the body the other way; all numbers assumed.

    m (z'' + a) + b z' + k z = -F, where a is the body's acceleration there and z the way of the mass on its spring:
    a positive voltage pushes the body up. The bodies' masses in `parameters` include the moving masses, held fast.

    Args:
        moving_mass_kg: mass on the spring.
        suspension_hz: natural frequency of that mass on a fixed body.
        suspension_damping: fraction of critical.
        newton_per_v: force of the coil per volt of its command: 2 N at 10 V.
        drive_hz: corner of its drive; section 2.1 has vibrations up to 100 Hz.
        limit_v: range of its command.
        at_m: where it stands, from the middle of the body's joints. Off the axis and off the planes of symmetry, so
            that it moves the body in more than one way; it breaks the hexapod's symmetry by about its share of mass.
    """

    moving_mass_kg: float = 0.1
    suspension_hz: float = 20.0
    suspension_damping: float = 0.3
    newton_per_v: float = 0.2
    drive_hz: float = 100.0
    limit_v: float = 10.0
    at_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


def _round_the_axis(radius_m: float, azimuth_deg: float) -> tuple[float, float, float]:
    angle = math.radians(azimuth_deg)
    return radius_m * math.cos(angle), radius_m * math.sin(angle), 0.0


# Assumed: 60 mm from the axis, where there is room beside the tri-axial geophone.
PROOF_MASSES = (ProofMass(at_m=_round_the_axis(0.06, 40.0)), ProofMass(at_m=_round_the_axis(0.06, -100.0)))


def triaxial_axes() -> FloatArray:
    """Return the sensitive axes of a tri-axial geophone as rows, `(3, 3)`: x, y and z turned by TILT_DEG.

    The turn is about the horizontal line across TILT_AZIMUTH_DEG, so that the third axis leans to that side.

    >>> axes = triaxial_axes()
    >>> round(math.degrees(math.acos(axes[2, 2])), 9), bool(np.allclose(axes @ axes.T, np.eye(3)))
    (5.0, True)
    """
    lean, side = math.radians(TILT_DEG), math.radians(TILT_AZIMUTH_DEG)
    about_z = np.array([[math.cos(side), -math.sin(side), 0], [math.sin(side), math.cos(side), 0], [0, 0, 1.0]])
    about_y = np.array([[math.cos(lean), 0, math.sin(lean)], [0, 1.0, 0], [-math.sin(lean), 0, math.cos(lean)]])
    return (about_z @ about_y @ about_z.T).T
