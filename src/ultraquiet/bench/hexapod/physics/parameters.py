"""What the bench is made of, each number with its source: paper, data sheet, fitted to eqs. (11)-(12), or assumed."""

import math
from dataclasses import dataclass

RATE_HZ = 3500.0  # section 3.1
STRUTS = 6
GEOPHONE_HZ = 12.0  # section 2.1


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
    """One strut: foot | stack | geophone's mass | viscoelastic stage."""

    # Foot, stack and mass resonate at 1.5 kHz (paper). The split is assumed, fitted to eq. (11): the feet yield, braced
    # against turning about z, so the yaw mode hardly shows and couplings level off above the modes; see `assemble`.
    stack_stiffness_n_per_m: float = 2.4e7
    foot_m_per_n: float = 1.37e-7
    moving_mass_kg: float = 0.063
    stack_damping: float = 0.01  # assumed, fraction of critical of the 1.5 kHz resonance
    free_stroke_m_per_v: float = 30e-6 / 165.0  # paper: 30 um over -15..150 V
    stage_stiffness_n_per_m: float = 3.48e5  # fitted to the 34.9 and 39.9 Hz poles of eq. (11)
    stage_loss: float = 0.167  # fitted likewise


@dataclass(frozen=True)
class Electronics:
    """Amplifier, conditioning and converters."""

    amplifier_hz: float = 102.0  # the pole 0.8325 of eq. (12)
    geophone_hz: float = GEOPHONE_HZ
    geophone_damping: float = 0.65  # assumed
    geophone_v_per_m_s: float = 100.0  # section 2.1: 0.1 V s/mm
    gain: float = 94.5  # needed to meet the gain of eq. (12)
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
PAYLOAD = Body(6.2 + 0.8, (0.083, 0.083, 0.057), 0.036)

# The satellite floats; mass, inertia and centre assumed, fitted to modes near 38, 54, 65 and 113 Hz and to eq. (11).
_SATELLITE = Body(65.0, (3.7, 3.7, 1.8), -0.14)
# The ground base stands on isotropic mounts (all assumed).
_GROUND = Body(150.0, (6.35, 6.35, 7.2), -0.04)

BASES: dict[str, Base] = {
    "ground": Base(_GROUND, mount_hz=6.0, mount_damping=0.05),
    "flight": Base(_SATELLITE),
    "rigid": Base(None),
}
