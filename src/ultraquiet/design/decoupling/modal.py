"""Independent modal-space control: damping asked for each mode of the plant's own modal form."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray, numbers, positive, rising_band
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.registry import register
from ultraquiet._base.shown.line import counted
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.plant_scale import EvenPlant, even_plant
from ultraquiet.design.fixed_structure.specification import Specification
from ultraquiet.design.gain_search import from_plant
from ultraquiet.design.h2.usual_numbers import UsualVariances
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.stabilisability import BORDER, place
from ultraquiet.design.verification import judged
from ultraquiet.linalg.equations import discrete_riccati
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

NEAR = 1e-6  # relative: an eigenvalue this near to where a mode was is that mode
# Damping when none is asked for: three times its own lowers the RMS of a mode by 5 dB, whatever it had; 0.15 of a sharp
# one by far more.
LEAST_ZETA, TIMES, MOST_ZETA = 0.15, 3.0, 0.7
# Where one of these is given, the other is what is usual for the plant; with neither, it is the measure.
NUMBERS = ("disturbance", "sensor_noise")


@register("design", "modal")
@dataclass(frozen=True)
class Modal(StatedRobustness):
    """Damping of chosen modes by state feedback, each moved without the others, on a Kalman filter's states.

    A mode with left vectors W (W A = L W) is moved by u = d f W x alone: all other eigenvalues stay. d is the
    combination of actuators that drives the mode most, f places its pair.

    By default the filter takes the plant as its measure: its channels are evened out over the band (`even_plant`), the
    disturbance has variance one at its inputs and the noise 1 / g^2 at its outputs, g halved from 32 until the loop
    keeps `disk_margin` at both ends. Who gives a variance gets exactly that, in the plant's own units.

    Args:
        band_hz: modes between these frequencies are damped, Hz; those in the plant's own band when absent.
        zeta: damping asked, of all of them or one number for each in rising frequency; modes with more are left. When
            absent, 0.15 or three times what a mode has, whichever is more, and 0.7 at most.
        disturbance: variance of the disturbance at the plant's inputs, input units squared, for the filter; where only
            the noise is given, a hundred times that at the outputs (`UsualVariances`).
        sensor_noise: variance at its outputs, 0.01 of the disturbance there where only that is given. More of it makes
            a slower, calmer filter.

    >>> plant = StateSpace([[0.98, 0.1], [-0.1, 0.98]], [[0.0], [0.1]], [[0.0, 1.0]], [[0.0]], rate_hz=1000.0)
    >>> result = Modal(band_hz=(5.0, 50.0), zeta=0.3).design(plant)
    >>> result.status.ok, round(float(result.details["modes"][0]["after"]), 3)
    (True, 0.3)

    Meirovitch and Baruh 1982, doi:10.2514/3.56117; by left vectors: Simon and Mitter 1968,
    doi:10.1016/S0019-9958(68)90834-8.
    """

    ask_for_more: ClassVar[str] = "ask for more damping by 'zeta', or of other modes by 'band_hz'"

    band_hz: tuple[float, float] | None = None
    zeta: float | tuple[float, ...] | None = None
    disturbance: float | None = None
    sensor_noise: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in NUMBERS:
            if getattr(self, name) is not None:
                positive("Modal", name, getattr(self, name))
        if self.band_hz is not None:
            rising_band("Modal", self.band_hz)
        if isinstance(self.zeta, list):
            object.__setattr__(self, "zeta", tuple(self.zeta))
        if self.zeta is not None:
            zeta = numbers("Modal", "zeta", self.zeta)
            if np.any(zeta <= 0) or np.any(zeta >= 1):
                raise InputError(f"Modal: 'zeta' must lie between 0 and 1, got {self.zeta}.")

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the controller u = K y of a discrete plant; `details["modes"]` are frequency and damping.

        Raises:
            InputError: a continuous plant, a band above Nyquist, another number of dampings than modes.
        """
        if plant.rate_hz is None:
            raise InputError("Modal: the plant is in continuous time; discretise it first.")
        if self.band_hz is not None and self.band_hz[1] >= plant.rate_hz / 2:
            raise InputError(
                f"Modal: the band ends at {self.band_hz[1]:g} Hz, at or above Nyquist, {plant.rate_hz / 2:g} Hz."
            )
        if self.disturbance is None and self.sensor_noise is None:
            return from_plant(plant, self, self._attempt, self.band_hz)
        found = replace(self, band_hz=self.band_hz or even_plant(plant).band_hz)._found(plant)
        law = found.controller
        if law is None:
            return found
        details = dict(found.details)
        if plant.D.shape[0] == plant.D.shape[1]:
            details["score"] = Specification(band_hz=details["band_hz"]).score(plant, law)
        return judged(plant, law, self, found.gamma, found.achieved, found.residuals, details)

    def _attempt(self, even: EvenPlant, g: float) -> DesignResult:
        """Return what is found for the even plant when the sensors' noise is 1 / g^2."""
        return replace(self, band_hz=even.band_hz, disturbance=1.0, sensor_noise=g**-2)._found(even.plant)

    def _found(self, plant: StateSpace) -> DesignResult:
        """Return the controller for settings that are all given, its loop not yet judged, or a refusal."""
        assert self.band_hz is not None
        disturbance, noise = self._variances(plant)
        try:
            F, modes = self._feedback(plant, self.band_hz)
            _require_moved(plant.A + plant.B @ F, plant.rate_hz, self.band_hz)
            Q = plant.B @ plant.B.T * disturbance
            R = noise * np.eye(plant.D.shape[0])
            filtering = discrete_riccati(plant.A.T, plant.C.T, Q, R)
        except NumericalError as error:
            return refused(f"Modal: {error}")
        X = filtering.X
        L = np.linalg.solve(R + plant.C @ X @ plant.C.T, plant.C @ X @ plant.A.T).T
        A = plant.A + plant.B @ F - L @ (plant.C + plant.D @ F)
        law = StateSpace(A, L, F, np.zeros((plant.D.shape[1], plant.D.shape[0])), plant.rate_hz)
        nan = float("nan")
        status = Status(StatusWord.OK, f"Damping is placed for {counted(len(modes), 'mode')}.")
        details = {"modes": modes, "band_hz": self.band_hz}
        return DesignResult(status, law, nan, nan, residuals={"filter": filtering.residual}, details=details)

    def _variances(self, plant: StateSpace) -> tuple[float, float]:
        """Return disturbance and noise, as given or the one as the other asks."""
        if self.disturbance is not None and self.sensor_noise is not None:
            return self.disturbance, self.sensor_noise
        return UsualVariances.of(plant, self.band_hz, at_input=True).both(self.disturbance, self.sensor_noise)

    def _feedback(self, plant: StateSpace, band_hz: tuple[float, float]) -> tuple[FloatArray, list[dict[str, float]]]:
        """Return F and what it does, one mode after the other."""
        rate = plant.rate_hz or 1.0
        poles = np.linalg.eigvals(plant.A)
        s = np.log(poles[(np.abs(poles) > NEAR) & (poles.imag > 0)]) * rate
        low, high = 2 * np.pi * np.asarray(band_hz)
        inside = (np.abs(s) >= low) & (np.abs(s) <= high)
        chosen = s[inside][np.argsort(np.abs(s[inside]))]
        had = -chosen.real / np.abs(chosen)
        wanted = np.clip(TIMES * had, LEAST_ZETA, MOST_ZETA) if self.zeta is None else np.atleast_1d(self.zeta)
        if wanted.size not in (1, chosen.size):
            raise InputError(f"Modal: got {wanted.size} dampings for {chosen.size} modes in the band.")
        F, modes = np.zeros(plant.B.T.shape), []
        for pole, before, zeta in zip(chosen, had, np.broadcast_to(wanted, chosen.shape), strict=True):
            w, after = float(np.abs(pole)), float(max(before, zeta))
            modes.append({"f_hz": w / (2 * np.pi), "before": float(before), "after": after})
            if after > before:
                target = np.exp(w * (-after + 1j * np.sqrt(1 - after**2)) / rate)
                F = F + _moved(plant.A + plant.B @ F, plant.B, np.exp(pole / rate), target)
        return F, modes


def _require_moved(A: FloatArray, rate_hz: float | None, band_hz: tuple[float, float]) -> None:
    """Refuse what state feedback leaves on or beyond the circle: an unstable mode that is none of those to be damped.

    Raises:
        NumericalError: the sentence.
    """
    poles = np.linalg.eigvals(A)
    left = poles[np.abs(poles) >= 1 - BORDER]
    if left.size:
        raise NumericalError(
            f"a mode of the plant that is not stable, {place(left[0], rate_hz)}, stays where it is, for only complex "
            f"pairs within {band_hz[0]:.4g}-{band_hz[1]:.4g} Hz are moved; stabilise it by another method."
        )


def _moved(A: FloatArray, B: FloatArray, pole: complex, target: complex) -> FloatArray:
    """Return F that moves one complex pair of A + B F to a target and leaves all else."""
    decomposition: Any = np.linalg.eig(A.T)
    values, left = decomposition
    k = int(np.argmin(np.abs(values - pole)))
    W = np.vstack([left[:, k].real, left[:, k].imag])
    re, im = values[k].real, values[k].imag
    block = np.array([[re, -im], [im, re]])  # W A = block W
    drive = W @ B
    d = np.linalg.svd(drive)[2][0]
    b = drive @ d
    reach = np.column_stack([b, block @ b])
    if np.linalg.cond(reach) > 1 / NEAR**2:
        raise NumericalError(f"the mode at z = {pole:.4g} is not driven by any actuator.")
    wanted = block @ block - 2 * target.real * block + abs(target) ** 2 * np.eye(2)
    f = -np.linalg.solve(reach.T, np.array([0.0, 1.0])) @ wanted  # Ackermann
    return np.asarray(np.outer(d, f @ W), dtype=np.float64)
