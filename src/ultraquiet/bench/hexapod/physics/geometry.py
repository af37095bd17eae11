"""Where the struts stand and how the bodies' motions stretch them."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.bench.hexapod.physics.parameters import STRUTS, Geometry


@dataclass(frozen=True, eq=False)
class Joints:
    """Joints of base and platform `(6, 3)` in metres, origin in the middle of the base joints, z towards the payload.

    Struts are numbered around the hexapod: 1 and 2 stand side by side on the base, 2 and 3 meet at the platform.
    """

    base: FloatArray
    platform: FloatArray

    @property
    def directions(self) -> FloatArray:
        """Unit vectors from base to platform along each strut, `(6, 3)`."""
        along = self.platform - self.base
        return along / np.linalg.norm(along, axis=1, keepdims=True)

    @property
    def lengths_m(self) -> FloatArray:
        """Length of each strut, `(6,)`."""
        return np.linalg.norm(self.platform - self.base, axis=1)


def joints(geometry: Geometry) -> Joints:
    """Return the joints: three pairs, mirror images within a pair, 120 degrees from pair to pair."""
    third = 2.0 * np.pi / 3.0
    side = np.tile([-1.0, 1.0], 3)
    centre = third * np.repeat(np.arange(3), 2)
    base = centre + side * np.radians(geometry.base_half_angle_deg)
    platform = centre + side * (third / 2.0 - np.radians(geometry.platform_half_angle_deg))
    return Joints(
        _circle(geometry.base_radius_m, base, 0.0),
        _circle(geometry.platform_radius_m, platform, geometry.height_m),
    )


def jacobian(points: FloatArray, directions: FloatArray, centre: FloatArray) -> FloatArray:
    """Return rows J_i = [s_i', ((p_i - c) x s_i)'], `(6, 6)`: speed along strut i per speed and spin of the body."""
    return np.hstack([directions, np.cross(points - centre, directions)])


def _circle(radius: float, angle: FloatArray, height: float) -> FloatArray:
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(STRUTS, height)])


def decoupling() -> FloatArray:
    """Return the constant orthonormal T that takes a symmetric hexapod apart, `(6, 6)`.

    T' G T = diag(g_1, g_2, H, H) at every frequency: two scalar loops (all struts alike; neighbours opposed) and one
    2 x 2 loop used twice (sway and rock to either side). T comes from the symmetry alone, threefold and mirror; it
    does not depend on lengths, masses or frequency. Where units differ from the drawing it holds as far as they do.

    >>> T = decoupling()
    >>> bool(np.allclose(T.T @ T, np.eye(6)))
    True
    """
    alike, opposed = np.array([1.0, 1.0]) / np.sqrt(2.0), np.array([-1.0, 1.0]) / np.sqrt(2.0)
    one = np.ones(3) / np.sqrt(3.0)
    x, y = np.array([2.0, -1.0, -1.0]) / np.sqrt(6.0), np.array([0.0, 1.0, -1.0]) / np.sqrt(2.0)
    pairs = ((one, alike), (one, opposed), (x, alike), (y, opposed), (y, alike), (-x, opposed))
    return np.column_stack([np.kron(around, within) for around, within in pairs])
