"""What the bench is made of, each number with its source: paper, data sheet, fitted to eqs. (11)-(12), or assumed."""

import math
from dataclasses import dataclass

RATE_HZ = 3500.0  # section 3.1
STRUTS = 6


@dataclass(frozen=True)
class Geometry:
    """Two plates with six joints each, in three pairs; all assumed and fitted to the couplings of eq. (11)."""

    base_radius_m: float = 0.160
    platform_radius_m: float = 0.145
    height_m: float = 0.084
    base_half_angle_deg: float = 8.5
    platform_half_angle_deg: float = 9.0


@dataclass(frozen=True)
class Strut:
    """One strut: stack | geophone's mass | viscoelastic stage."""

    stack_stiffness_n_per_m: float = 5.5e6  # with the mass below: 1.5 kHz (paper); the split is assumed
    moving_mass_kg: float = 0.062
    stack_damping: float = 0.01  # assumed, fraction of critical of the 1.5 kHz resonance
    free_stroke_m_per_v: float = 30e-6 / 165.0  # paper: 30 um over -15..150 V
    stage_stiffness_n_per_m: float = 3.5e5  # fitted to the 34.9 and 39.9 Hz poles of eq. (11)
    stage_loss: float = 0.167  # fitted likewise


@dataclass(frozen=True)
class Electronics:
    """Amplifier, conditioning and converters."""

    amplifier_hz: float = 102.0  # the pole 0.8325 of eq. (12)
    geophone_hz: float = 12.0  # section 2.1
    geophone_damping: float = 0.65  # assumed
    geophone_v_per_m_s: float = 100.0  # section 2.1: 0.1 V s/mm
    gain: float = 96.7  # needed to meet the gain of eq. (12)
    filter_hz: float = 1000.0  # section 3.1: 2-pole anti-alias filter
    filter_damping: float = 1.0 / math.sqrt(2.0)  # assumed Butterworth
    command_limit_v: float = 25.0  # section 3.3
    reading_limit_v: float = 10.0  # section 3.5
    stack_low_v: float = -15.0  # section 2.1
    stack_high_v: float = 150.0
    noise_v: float = 0.01  # section 4.2: mean standard deviation of the readings at rest

    @property
    def bias_v(self) -> float:
        """Resting voltage of the stack, the middle of its range (assumed)."""
        return 0.5 * (self.stack_low_v + self.stack_high_v)


@dataclass(frozen=True)
class Body:
    """A rigid body: mass, principal inertias about its centre of mass, that centre over and beside its joints."""

    mass_kg: float
    inertia_kg_m2: tuple[float, float, float]
    centre_m: float
    aside_m: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Base:
    """What the struts stand on. No body: an immovable floor. No mounts: it floats."""

    body: Body | None
    mount_hz: float = 0.0
    mount_damping: float = 0.0


# Payload 6.2 kg (paper) and platform 0.8 kg (assumed). Inertia and centre are assumed, fitted to modes near 35, 51, 64
# and 112 Hz on the rigid floor with a stage that stiffens with frequency, as a lossy one must.
PAYLOAD = Body(6.2 + 0.8, (0.084, 0.084, 0.0545), 0.036)

# The satellite floats; mass, inertia and centre assumed, fitted to modes near 38, 54, 65 and 113 Hz.
_SATELLITE = Body(52.0, (2.2, 2.2, 2.5), -0.04)
_GROUND_KG = 150.0
# The ground base has the satellite's shape, scaled in mass, on isotropic mounts (assumed).
_GROUND = Body(_GROUND_KG, (2.2 * _GROUND_KG / 52.0, 2.2 * _GROUND_KG / 52.0, 2.5 * _GROUND_KG / 52.0), -0.04)

BASES: dict[str, Base] = {
    "ground": Base(_GROUND, mount_hz=6.0, mount_damping=0.05),
    "flight": Base(_SATELLITE),
    "rigid": Base(None),
}
