"""What every adaptive law shares: a linear law inside, limits, and a watch that brings it to rest when it does harm."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, real_array
from ultraquiet._base.errors import InputError
from ultraquiet.design.result import DesignResult
from ultraquiet.design.tones.inner_loop import Inner
from ultraquiet.linalg import balance
from ultraquiet.linalg.response import principal_gains
from ultraquiet.values.channel import Channel
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

BELIEVED = 2.0**500  # no reading is larger, in whatever unit; the squares of smaller ones have a sum
RAMP_S = 0.1  # from the last good command to zero
PATIENCE_S = 1.0  # at a limit, before the law is doubted
GRID = 512  # frequencies at which gains are told
PROBE_S = 1.0  # at rest, to hear whether that is quieter
MEAN_S = 0.25  # of the running power of the readings
NEGLIGIBLE = 1e-3  # Hankel values below this share of the largest leave the models that make regressors
WORSE = 1.25  # power with the law against power at rest, above which it did harm

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class AdaptiveLaw:
    """u = K0 y + v, sample by sample; v adapts. A subclass fills in `_start` and `_adapt`.

    `status` is `ok`, `limited` (some command stood at its limit for a second, but at rest it was louder), or
    `diverged`: readings or states were no longer finite, or a second at a limit was louder than the rest that followed.
    Then v goes to zero within a tenth of a second and stays there until `reset`; K0 goes on while it is finite.

    Args:
        who: opens the sentences.
        inner: K0 and the plant that v meets.
        law: the linear law that this one is while its parameters stand still.
        limit: largest |v|, in the actuators' units, `(nu,)`.
    """

    def __init__(self, who: str, inner: Inner, law: StateSpace, limit: FloatArray) -> None:
        assert inner.seen.rate_hz is not None
        self.law, self.limit = law, limit
        self._who, self._inner, self._rate = who, inner, inner.seen.rate_hz
        self._first = contiguous(inner.first)
        self._mean = 1.0 / (MEAN_S * self._rate)
        self.reset()

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz."""
        return self._rate

    @property
    def limit_v(self) -> FloatArray:
        """What `limit` is; its older name."""
        return self.limit

    @property
    def status(self) -> Status:
        """How the law feels."""
        return self._status

    def reset(self) -> None:
        """Return to rest and forget."""
        nu, ny = self._inner.first.D.shape
        self._status = Status(StatusWord.OK, f"{self._who}: adapting.")
        self._x, self._work = np.zeros(self._inner.first.states), np.zeros(self._inner.first.states)
        self._base, self._v, self._y0 = np.zeros(nu), np.zeros(nu), np.zeros(ny)
        self._last, self._sent, self._fade = np.zeros(nu), np.zeros(nu), -1
        self._power, self._at_limit, self._probe, self._with_law = 0.0, 0, 0, 0.0
        self._trusted = False
        self._start()

    def _start(self) -> None:
        """Return what adapts to rest."""
        raise NotImplementedError

    def _adapt(self, y: FloatArray) -> int:
        """Fill `_v` and `_y0` for the readings of this sample; return how many limits were met."""
        raise NotImplementedError

    def step(self, y: Any) -> FloatArray:
        """Return the commands `(nu,)` for the readings `(ny,)` of this sample; always finite.

        Raises:
            InputError: another number of readings.
        """
        # A fresh array: loops hand columns over, and every layout would be compiled for again.
        readings = np.array(y, dtype=np.float64, order="C").reshape(-1)
        if readings.size != self._inner.first.D.shape[1]:
            raise InputError(f"{self._who}: takes {self._inner.first.D.shape[1]} readings, got {readings.size}.")
        sound = bool((np.abs(readings) <= BELIEVED).all())  # not a number is not less than anything
        base = self._linear(readings) if sound else None
        if base is None:
            self._diverged("a reading, or the law around which it was put, was no number to be believed")
            return self._faded(self._sent)
        self._power += self._mean * (float(readings @ readings) - self._power)
        if self._fade >= 0 and not self._resumes():
            return base + self._faded(self._last)
        try:
            met = self._adapt(readings)
        except ZeroDivisionError:
            met = -1
        if met < 0 or not np.isfinite(self._v).all():
            self._diverged("its parameters were no longer finite")
            return base + self._faded(self._last)
        self._watch(met)
        self._last = self._v.copy()
        self._sent = base + self._last
        return self._sent.copy()

    def _linear(self, y: FloatArray) -> FloatArray | None:
        from ultraquiet.design.tones.kernels import linear_step

        if not self._x.size:
            return self._first[3] @ y
        linear_step(self._first, self._x, self._work, y, self._base)
        return self._base.copy() if np.isfinite(self._base).all() else None

    def _watch(self, met: int) -> None:
        """Doubt the law once it has been at a limit for long, and try what rest would be like."""
        self._at_limit = self._at_limit + 1 if met else max(self._at_limit - 1, 0)
        if self._at_limit > PATIENCE_S * self._rate and not self._trusted:
            self._with_law, self._fade, self._probe = self._power, 0, round(PROBE_S * self._rate)

    def _resumes(self) -> bool:
        """Count down the rest; then stay there when it is quieter, else begin again."""
        if self._probe == 0:
            return False
        self._probe -= 1
        if self._probe:
            return False
        if self._with_law > WORSE * self._power:
            ratio = 10 * np.log10(self._with_law / max(self._power, np.finfo(float).tiny))
            self._diverged(f"at its limit it was {ratio:.1f} dB louder than at rest")
            return False
        self._status = Status(
            StatusWord.LIMITED, f"{self._who}: commands stand at their limit; the tone is only made smaller."
        )
        self._fade, self._at_limit, self._trusted = -1, 0, True
        self._start()
        return True

    def _diverged(self, why: str) -> None:
        if self._status.word != StatusWord.DIVERGED:
            self._status = Status(StatusWord.DIVERGED, f"{self._who}: brought to rest, because {why}.")
            self._fade = max(self._fade, 0)
        self._probe = 0

    def _faded(self, last: FloatArray) -> FloatArray:
        """Return the command on the way from `last` to rest."""
        share = max(1.0 - self._fade / (RAMP_S * self._rate), 0.0)
        self._fade += 1
        return share * last


def adapting(result: DesignResult, law: AdaptiveLaw) -> DesignResult:
    """Return a result that holds a law that adapts beside the linear one it is at rest, and says so."""
    sentence = f"Adaptive, to be run as `law`. While its parameters stand still: {result.status.sentence}"
    return replace(result, law=law, status=Status(result.status.word, sentence))


def contiguous(system: StateSpace) -> Matrices:
    """Return A, B, C, D as the kernels take them."""
    A, B, C, D = (np.array(m, order="C") for m in (system.A, system.B, system.C, system.D))
    return A, B, C, D


def limits_of(who: str, limit: float | tuple[float, ...] | None, actuators: Sequence[Channel]) -> FloatArray:
    """Return one limit per actuator, in its unit: as given, else its own.

    Raises:
        InputError: a limit that is not above zero, or an actuator without one: the watch would be blind, since it is
            at a limit that a law which does harm is told.
    """
    nu = len(actuators)
    if limit is None:
        unknown = [c for c in actuators if not np.isfinite(_nearer_end(c))]
        if unknown:
            names = ", ".join(f"'{c.name}'" for c in unknown)
            unit = f", in {unknown[0].unit}" if unknown[0].unit and len({c.unit for c in unknown}) == 1 else ""
            raise InputError(
                f"{who}: no limit of {names} is known, and it is at a limit that a law which adapts is told that it "
                f"does harm; state the largest command as 'limit'{unit}, or give the actuators their ranges."
            )
        return np.array([_nearer_end(c) for c in actuators], dtype=np.float64)
    limits = real_array(who, "limit", np.atleast_1d(np.asarray(limit)), 1)
    if limits.size not in (1, nu) or not np.all(limits > 0):
        each = "" if nu == 1 else f", or {nu} of them"
        raise InputError(f"{who}: 'limit' must be one number above zero{each}, got {limit!r}.")
    return np.ascontiguousarray(np.broadcast_to(limits, (nu,)), dtype=np.float64)


def _nearer_end(wire: Channel) -> float:
    return min(abs(wire.low), abs(wire.high))


def largest_regressor(system: StateSpace, limit: FloatArray) -> float:
    """Return max |G| max |G diag(limit)| over frequency: readings that commands at their limits make, filtered by G.

    Such readings are what an adaptive law learns from, in whatever units the channels count; one where G is zero.
    """
    assert system.rate_hz is not None
    f_hz = np.linspace(0, system.rate_hz / 2, GRID + 2)[1:-1]
    G = system.frequency_response(f_hz)
    largest = principal_gains(G).max() * principal_gains(G * limit[:, None]).max()
    return float(largest) if largest > 0 else 1.0


def without_faint_states(system: StateSpace) -> StateSpace:
    """Return a stable system without the states that hardly matter: dozens of copies of it may run beside the loop."""
    M = balance.without_faint((system.A, system.B, system.C, system.D), NEGLIGIBLE, discrete=True)
    return StateSpace(*M, rate_hz=system.rate_hz)
