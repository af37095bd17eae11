"""SUITE's hexapod: six struts, each a piezo stack, a geophone and a viscoelastic stage, between base and payload.

Facts that the simulated bench brings out, each measured and printed by a test of tests/bench:

* |f22| lies within 1.5 dB of eq. (12) and |f21| within 5 dB of eq. (11) over 25-250 Hz. The latter takes feet that
  yield under the stacks, braced against turning about z: eq. (11) shows no yaw mode near 113 Hz and is level above.
* That brace makes the six struts' common twist resonate at 3.1 kHz, beyond half the rate; the other five at 1.5 kHz.
* Eq. (10) has three zeros at DC. Held and sampled, one stays; the others become a pair near 0.6 Hz inside the circle,
  this high because the twist at 3.1 kHz is near the rate.
* One real zero near z = -2.3 comes from sampling: the like of the paper's "1787 Hz" (z = -1.92). The bench has no zeros
  outside the circle at 1 or 3 Hz.
* The struts resonate near 1.55 kHz with a gain of 13 V/V, below half the sampling rate: a controller must roll off.
* The symmetric hexapod falls apart into two scalar loops and one 2 x 2 used twice, by a constant orthonormal transform
  (`geometry.decoupling`), to 1e-11. Proof masses off the axis break this by less than half a per cent of |G|, a unit
  within its tolerances by about a tenth.
* The series resistor and capacitor of eq. (9) lag by 0.15 degrees at 1 Hz and 7.4 at 50 Hz: linear, not the
  rate-independent hysteresis the text names. The bench's plays give closed, congruent loops, 5.4 % wide at +-25 V.
* On a rigid floor proof mass and geophones of the base are there, but move nothing and read nothing but noise.
* A stage with a loss factor of 0.167 cannot have a constant stiffness: it grows by a quarter from 20 to 120 Hz.
"""

from ultraquiet.bench.hexapod.unit import Hexapod

__all__ = ["Hexapod"]
