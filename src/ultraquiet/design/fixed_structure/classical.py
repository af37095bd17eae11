"""Classical sections on each channel: lead-lag, notch, corners and a gain, in numbers or tuned."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive, real_array, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.design.fixed_structure.specification import Specification, specified
from ultraquiet.design.fixed_structure.tuning import InitialLaw, posed, tuned, worded
from ultraquiet.design.law_structure.controller_structure import ControllerStructure, decentralised, repeated
from ultraquiet.design.law_structure.plane import Plane, plane_of
from ultraquiet.design.law_structure.sections import SectionCascade
from ultraquiet.design.result import DesignResult
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.structure_words import DECENTRALISED, REPEATED, structure_word
from ultraquiet.design.verification import judged
from ultraquiet.linalg.response import principal_gains
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

# Gains tried when none is given: this many a decade over these decades about 1 / |G|, of both signs.
A_DECADE, DECADES = 8, (-3.0, 2.0)
FAINT = 1e-8  # of the largest gain: no loop is closed about less
LOOKS = 4  # the grid is refined at what was found and the gain sought again
ALLOWED = 0.98  # of what is hard


@dataclass(frozen=True)
class ClassicalMethod(StatedRobustness):
    """Settings that all methods of classical sections share, and their verb."""

    square_plants: ClassVar[bool] = True  # `design` takes no others

    gain: float | tuple[float, ...] | None = None
    high_pass_hz: float | None = None
    low_pass_hz: float | None = None
    tune: bool = False
    structure: str = REPEATED
    specification: Specification | Mapping[str, Any] | None = None
    starts: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        word = structure_word(type(self).__name__, self.structure, (REPEATED, DECENTRALISED))
        object.__setattr__(self, "structure", word)
        object.__setattr__(self, "specification", specified(self.specification))
        whole(type(self).__name__, "seed", self.seed, 0)
        if isinstance(self.gain, list):
            object.__setattr__(self, "gain", tuple(self.gain))

    def sections(self) -> list[tuple[str, tuple[float, ...], tuple[bool, ...]]]:
        """Return kind, values and which of them are frequencies in Hz, of the method's own sections."""
        raise NotImplementedError

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return u = K y with the same sections on every channel, or each its own when tuned `decentralised`.

        Without a gain the one is sought that attenuates most within the specification's peak and control limit; with
        `tune` gains, corners and dampings are all tuned. `details["values"]` holds the sections as they came out, Hz.

        Raises:
            InputError: a plant that is not square, another number of gains than channels, corners above Nyquist.
        """
        who = type(self).__name__
        wanted = self.specification if isinstance(self.specification, Specification) else Specification()
        wanted.fits(who, plant)
        wanted = wanted.on(plant)
        n = plant.D.shape[0]
        plane = plane_of(plant)
        cascades = [self._cascade(who, plane, g) for g in self._gains(n, plant, wanted)]
        if len(cascades) == 1 and self.structure == REPEATED:
            structure = repeated(cascades[0], n)
        else:
            cascades = cascades if len(cascades) == n else cascades * n
            structure = decentralised(tuple(cascades), n)
        theta = np.concatenate([c.origin for c in cascades])
        demanded = self.specification is not None
        if self.gain is None:
            theta = _best_gain(plant, structure, theta, wanted)
        if self.tune:
            result = tuned(plant, InitialLaw(structure, theta), wanted, self, self.starts, self.seed, demanded)
            if "theta" in result.details:
                result.details["values"] = self._values_hz(plane, cascades, structure, result.details["theta"])  # type: ignore[index]
            return result
        law = structure.law(theta, plane)
        score = wanted.score(plant, law)
        level = float(np.max(posed(plant, structure, wanted).measured(theta)))
        details = {
            "score": score,
            "specification": wanted,
            "values": self._values_hz(plane, cascades, structure, theta),
        }
        return worded(judged(plant, law, self, level, level, {}, details), score, demanded)

    def _gains(self, n: int, plant: StateSpace, wanted: Specification) -> list[float]:
        if self.gain is None:
            heard = _gains_heard(plant, wanted)
            return [1.0 / float(heard.max()) if heard.size else 1.0]
        who = type(self).__name__
        gains = real_array(who, "gain", np.atleast_1d(np.asarray(self.gain)), 1)
        if gains.size not in (1, n):
            raise InputError(f"{who}: got {gains.size} gains for {n} channels; give one, or one for each.")
        return [float(g) for g in gains]

    def _cascade(self, who: str, plane: Plane, gain: float) -> SectionCascade:
        kinds, values = [], []
        for kind, numbers, in_hz in self._all():
            kinds.append(kind)
            for v, is_hz in zip(numbers, in_hz, strict=True):
                positive(who, f"a value of a {kind} section", v, "Hz" if is_hz else "")
                if is_hz and plane.rate_hz is not None and v >= plane.rate_hz / 2:
                    raise InputError(
                        f"{who}: a {kind} corner of {v:g} Hz{self._set_as(v)} lies at or above Nyquist, "
                        f"{plane.rate_hz / 2:g} Hz; set it lower."
                    )
                values.append(float(plane.of_hz(v)) if is_hz else float(v))
        return SectionCascade(tuple(kinds), gain, tuple(values))

    def _set_as(self, value: float) -> str:
        """Return which setting a value comes from, in words; that may be a default, which nobody set."""
        names = [f.name for f in fields(self) if f.name.endswith("_hz")]
        found = [name for name in names if value in np.atleast_1d(np.asarray(getattr(self, name), dtype=object))]
        return f" ('{found[0]}')" if found else ""

    def _all(self) -> list[tuple[str, tuple[float, ...], tuple[bool, ...]]]:
        out = self.sections()
        if self.high_pass_hz is not None:
            out.append(("high-pass", (self.high_pass_hz,), (True,)))
        if self.low_pass_hz is not None:
            out.append(("low-pass", (self.low_pass_hz,), (True,)))
        return out

    def _values_hz(
        self, plane: Plane, cascades: list[SectionCascade], structure: ControllerStructure, theta: FloatArray
    ) -> list[dict[str, Any]]:
        """Return gain and sections of every law in Hz."""
        out = []
        for cascade, parameters in zip(cascades, structure.parts(theta), strict=False):
            numbers, at, sections = cascade.numbers(parameters), 0, []
            for kind, initial, in_hz in self._all():
                mine = numbers[at : at + len(initial)]
                sections.append(
                    (kind, tuple(float(plane.hz(v)) if h else float(v) for v, h in zip(mine, in_hz, strict=True)))
                )
                at += len(initial)
            out.append({"gain": float(cascade.gain * parameters[0]), "sections": tuple(sections)})
        return out


def _best_gain(
    plant: StateSpace, structure: ControllerStructure, theta: FloatArray, wanted: Specification
) -> FloatArray:
    """Return the parameters with the common gain that attenuates most among those that meet what is hard.

    Where none does, the stable loop that misses it least: what is tuned then begins at a loop that is one.
    """
    problem = posed(plant, structure, wanted)
    # where the plant falls off, as integrators do, the gain that closes a loop there is as much higher
    heard = _gains_heard(plant, wanted)
    top = DECADES[1] + (np.log10(heard.max() / max(heard.min(), FAINT * heard.max())) if heard.size else 0.0)
    scale = np.geomspace(10 ** DECADES[0], 10**top, round(A_DECADE * (top - DECADES[0])) + 1)
    first = np.cumsum([0] + [e.size for e in structure.elements[:-1]])
    best = theta
    for _ in range(LOOKS):
        best, least = theta, (np.inf, np.inf)
        for factor in np.concatenate([-scale, scale]):
            trial = theta.copy()
            trial[first] *= factor
            if not np.isfinite(problem.value(trial)):
                continue
            missed = max(float(problem.measured(trial)[1:].max()), ALLOWED)
            # one gain cannot lift the worst frequency of a band: its mean counts
            if (missed, problem.mean_db(trial)) < least:
                best, least = trial, (missed, problem.mean_db(trial))
        problem.soft = 1 / max(problem.measured(best)[0], 1.0)
        if problem.refine(best) <= 1 - ALLOWED:
            break
    return best


def _gains_heard(plant: StateSpace, wanted: Specification) -> FloatArray:
    """Return the plant's largest gains over all frequencies that a law may be about."""
    if plant.rate_hz is None:
        return wanted.gains(plant)
    f = np.geomspace(1e-3, 0.4, 50) * plant.rate_hz
    size = principal_gains(plant.frequency_response(f))[0]
    return np.concatenate([size[np.isfinite(size) & (size > 0)], wanted.gains(plant)])


@register("design", "lead-lag")
@dataclass(frozen=True)
class LeadLag(ClassicalMethod):
    """Lead-lag sections, K = gain prod (1 + s/z) / (1 + s/p) with corners, for each channel alone.

    Args:
        gain: of each channel, or one for all, its sign inside; None seeks the best within the specification.
        high_pass_hz, low_pass_hz: first-order corners besides, Hz.
        tune: whether all numbers are tuned to the specification, beginning with those given.
        structure: `repeated` or `decentralised`: whether tuned channels may differ.
        specification: what is asked, also as a table of its settings; absent, attenuation is a wish and no demand.
        starts, seed: of the search.
        zeros_hz, poles_hz: corners of the sections, Hz; lead where the zero comes first.
        notches_hz, notch_zetas, notch_widths: centres, damping of the zeros, damping of the poles of notches besides.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> result = LeadLag(gain=-0.5, zeros_hz=(200.0,), poles_hz=(1000.0,)).design(plant)
    >>> result.status.ok, round(float(abs(result.controller.frequency_response([0.0])[0, 0, 0])), 3)
    (True, 0.5)

    Franklin, Powell and Emami-Naeini 2015, section 6.7.
    """

    zeros_hz: tuple[float, ...] = ()
    poles_hz: tuple[float, ...] = ()
    notches_hz: tuple[float, ...] = ()
    notch_zetas: tuple[float, ...] = ()
    notch_widths: tuple[float, ...] = ()

    def sections(self) -> list[tuple[str, tuple[float, ...], tuple[bool, ...]]]:
        """Return the lead-lag sections and the notches."""
        if len(self.zeros_hz) != len(self.poles_hz):
            raise InputError(
                f"LeadLag: {len(self.zeros_hz)} zeros and {len(self.poles_hz)} poles; give as many of both."
            )
        pairs = zip(self.zeros_hz, self.poles_hz, strict=True)
        return [("lead-lag", pair, (True, True)) for pair in pairs] + _notches(
            "LeadLag", self.notches_hz, self.notch_zetas, self.notch_widths
        )


@register("design", "notch")
@dataclass(frozen=True)
class Notch(ClassicalMethod):
    """Notches on each channel, K = gain prod (s^2 + 2 zeta_z w s + w^2) / (s^2 + 2 zeta_p w s + w^2).

    Args:
        gain, high_pass_hz, low_pass_hz, tune, structure, specification, starts, seed: as in `LeadLag`.
        notches_hz: centres, Hz.
        zetas: damping of the zeros; the depth is zeta / width. Above the width the section lifts instead.
        widths: damping of the poles.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> law = Notch(gain=-1.0, notches_hz=(50.0,), zetas=(0.01,), widths=(0.5,)).design(plant).controller
    >>> round(float(abs(law.frequency_response([50.0])[0, 0, 0])), 3)
    0.02
    """

    notches_hz: tuple[float, ...] = ()
    zetas: tuple[float, ...] = ()
    widths: tuple[float, ...] = ()

    def sections(self) -> list[tuple[str, tuple[float, ...], tuple[bool, ...]]]:
        """Return the notches."""
        return _notches("Notch", self.notches_hz, self.zetas, self.widths)


def _notches(
    who: str, centres: tuple[float, ...], zetas: tuple[float, ...], widths: tuple[float, ...]
) -> list[tuple[str, tuple[float, ...], tuple[bool, ...]]]:
    if not len(centres) == len(zetas) == len(widths):
        raise InputError(
            f"{who}: {len(centres)} notches with {len(zetas)} dampings and {len(widths)} widths; give as many of each."
        )
    return [("notch", v, (True, False, False)) for v in zip(centres, zetas, widths, strict=True)]
