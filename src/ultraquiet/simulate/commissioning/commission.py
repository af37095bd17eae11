"""A law comes on at a share of its gain, is looked at without a model, and comes on further or is taken off."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive, rising_band
from ultraquiet._base.errors import InputError, UltraquietError, of_the_loop
from ultraquiet._base.progress import task
from ultraquiet.bench import Bench
from ultraquiet.simulate.commissioning.injection import (
    WHO,
    Halted,
    Injection,
    MeasuredLoop,
    joined,
    measured_loop,
    open_levels,
)
from ultraquiet.simulate.commissioning.margins import disk_margin_of, foreseen, peak_db
from ultraquiet.simulate.kick import swings
from ultraquiet.simulate.stability import check_stability
from ultraquiet.values import StateSpace
from ultraquiet.values.controller import Controller
from ultraquiet.values.status import Status, StatusWord

GAINS = (0.1, 0.3, 1.0)
READING_SHARE = 0.3  # of a sensor's range that an injection may use without a law: what the law amplifies has room
COMMAND_SHARE = 0.4  # of an actuator's range
BELOW, TOP_SHARE = 4.0, 0.97  # injections begin so far below the band and end at this share of half the rate


@dataclass(frozen=True, eq=False)
class CommissioningStep:
    """One gain: what was measured there, and what the next one was foreseen to leave.

    `disk` and `disk_hz`: disk margin of all channels of an end at once, and where it is least; `peak_db` of S at each
    end with the bound that noise leaves; `reduction_db` of the worst direction at the outputs over the band.
    `next_disk` is the least margin on the way to the next gain, as the loop measured here foresees it, at `next_gain`.
    """

    gain: float
    loop: MeasuredLoop
    disk: dict[str, float]
    disk_hz: dict[str, float]
    peak_db: dict[str, float]
    reduction_db: float | None
    next_disk: float | None = None
    next_gain: float | None = None
    next_hz: float | None = None


@dataclass(frozen=True, eq=False)
class Commissioning:
    """How a law came on. `status` is ok when it runs at its whole gain; `gain` is the last at which it ran."""

    steps: tuple[CommissioningStep, ...]
    gain: float
    status: Status


def commission(
    bench: Bench,
    controller: StateSpace | Controller,
    band_hz: tuple[float, float],
    *,
    gains: Sequence[float] = GAINS,
    margin: float = 0.2,
    seconds: float = 4.0,
    settle_s: float = 2.0,
    ramp_s: float = 0.1,
    watched_s: float | None = None,
) -> Commissioning:
    """Put a law on at rising shares of its gain; at each measure both sensitivities and the margins without a model.

    Sines are injected at one actuator after the other while the law runs. What the commands are of the injection is
    (I - K G)^-1, what the readings are of it gives (I - G K)^-1; both margins come from these alone. From the loop as
    measured follows what the next gain, and every gain on the way, will leave: the law goes on only if that is
    `margin` at least. A reading or a command that meets its limit ends the run at once, faded out within `ramp_s`.

    Margins are those at the lines of the injection: what grows between two of them, a sharp mode, is heard at the end,
    when `check_stability` watches the loop at its whole gain.

    Args:
        bench: any bench; one that streams can be stopped within a run.
        controller: u = K y, of all channels of the bench.
        band_hz: where the reduction of the worst direction is told.
        gains: shares of the law's gain, rising.
        margin: disk margin of all channels at once, at both ends, below which the law is taken off.
        seconds: a period of the injection, two of which are measured; its inverse is the lowest line.
        settle_s: before them.
        ramp_s: within which an aborted run fades out.
        watched_s: longest record of `check_stability` at the end; 0 leaves it out, absent it takes what it needs.

    Returns:
        `Commissioning`, a step for each gain at which the law ran.

    Raises:
        InputError: gains that do not rise, a law of other channels, an actuator that moves nothing.
        BenchError: the bench failed, or was stopped by something else than what was sent or read.
    """
    rate = bench.rate_hz
    low, high = rising_band(WHO, band_hz, rate)
    between(WHO, "margin", margin, 0.0, 2.0)
    shares = _rising(gains)
    settle, ramp = (
        max(1, round(positive(WHO, name, s, "s") * rate)) for name, s in (("settle_s", settle_s), ("ramp_s", ramp_s))
    )
    first = max(1.0 / positive(WHO, "seconds", seconds, "s"), low / BELOW)
    edges = sorted({first, *(f for f in (2 * low, high) if first < f < TOP_SHARE * rate / 2), TOP_SHARE * rate / 2})
    passes = Injection.passes(edges, seconds, rate)
    levels = [open_levels(bench, each, READING_SHARE, settle, _levels(bench)) for each in passes]
    steps: list[CommissioningStep] = []
    with task("commissioning", len(shares)) as progress:
        for k, gain in enumerate(shares):
            try:
                law = scaled(controller, gain)
                parts = [measured_loop(bench, law, *sent, settle, ramp) for sent in zip(passes, levels, strict=True)]
            except (Halted, UltraquietError) as error:
                if isinstance(error, UltraquietError) and not of_the_loop(error):
                    raise
                return _ended(steps, f"Faded out at {gain:.0%} of its gain: {str(error).rstrip('.')}.")
            step = _judged(gain, joined(parts), band_hz)
            if k + 1 < len(shares):
                least, at, hz = foreseen(step.loop, gain, shares[k + 1])
                step = replace(step, next_disk=least, next_gain=at, next_hz=hz)
            steps.append(step)
            progress.advance(note=f"{gain:.0%} of the gain")
            refusal = _refused(step, margin)
            if refusal is not None:
                return Commissioning(tuple(steps), gain, refusal)
    seen = None if watched_s == 0 else check_stability(bench, scaled(controller, shares[-1]), watched_s)
    if seen is not None and seen.status.word is StatusWord.UNSTABLE:
        return _ended(steps[:-1], f"Taken off at {shares[-1]:.0%} of its gain: {seen.status.sentence}")
    last = steps[-1]
    end = min(last.disk, key=lambda each: last.disk[each])
    sentence = (
        f"The law runs at {last.gain:.0%} of its gain; all channels at once keep a disk margin of {last.disk[end]:.2f} "
        f"at the plant's {end}, measured without a model."
    )
    if seen is not None and not seen.status.ok:
        return Commissioning(tuple(steps), last.gain, Status(seen.status.word, f"{sentence} {seen.status.sentence}"))
    return Commissioning(tuple(steps), last.gain, Status(StatusWord.OK, sentence))


def scaled(law: StateSpace | Controller, gain: float) -> StateSpace | Controller:
    """Return a law with a share of its gain; it starts from rest."""
    if isinstance(law, StateSpace):
        return replace_gain(law, gain)
    return _Scaled(law, gain)


def replace_gain(law: StateSpace, gain: float) -> StateSpace:
    """Return gain K."""
    return StateSpace(law.A, law.B, gain * law.C, gain * law.D, law.rate_hz)


class _Scaled:
    """A share of what a controller commands."""

    def __init__(self, law: Controller, gain: float) -> None:
        self._law, self._gain, self.rate_hz = law, gain, law.rate_hz

    def reset(self) -> None:
        self._law.reset()

    def step(self, y: FloatArray) -> FloatArray:
        return self._gain * np.asarray(self._law.step(y), dtype=np.float64)


def _judged(gain: float, loop: MeasuredLoop, band_hz: tuple[float, float]) -> CommissioningStep:
    disks = {end: disk_margin_of(S, loop.f_hz) for end, S in loop.ends().items()}
    sizes = {end: peak_db(S) for end, S in loop.ends().items()}
    # What noise leaves open counts as amplification.
    bounds = {end: 20 * np.log10(10 ** (size / 20) + loop.deviation) for end, size in sizes.items()}
    inside = (loop.f_hz >= band_hz[0]) & (loop.f_hz <= band_hz[1])
    return CommissioningStep(
        gain=gain,
        loop=loop,
        disk={end: alpha for end, (alpha, _) in disks.items()},
        disk_hz={end: f for end, (_, f) in disks.items()},
        peak_db={end: float(bound.max()) for end, bound in bounds.items()},
        reduction_db=float(-bounds["output"][inside].max()) if inside.any() else None,
    )


def _refused(step: CommissioningStep, margin: float) -> Status | None:
    """Return why a law is taken off after a step, if it is."""
    end = min(step.disk, key=lambda each: step.disk[each])
    if step.disk[end] < margin:
        sentence = (
            f"Taken off at {step.gain:.0%} of its gain: all channels at once keep a disk margin of "
            f"{step.disk[end]:.2f} at the plant's {end}, least at {step.disk_hz[end]:.4g} Hz, {margin:g} was asked."
        )
        return Status(StatusWord.FRAGILE, sentence)
    if step.next_disk is not None and step.next_disk < margin:
        sentence = (
            f"Taken off at {step.gain:.0%} of its gain: the loop measured there would keep a disk margin of "
            f"{step.next_disk:.2f} at {step.next_gain:.0%}, least at {step.next_hz:.4g} Hz, {margin:g} was asked."
        )
        return Status(StatusWord.FRAGILE, sentence)
    return None


def _ended(steps: list[CommissioningStep], sentence: str) -> Commissioning:
    last = steps[-1].gain if steps else 0.0
    return Commissioning(tuple(steps), last, Status(StatusWord.UNSTABLE, sentence))


def _levels(bench: Bench) -> FloatArray:
    reach = swings(WHO, bench.actuators)
    return np.where(np.isfinite(reach), COMMAND_SHARE * reach, 1.0)


def _rising(gains: Sequence[float]) -> tuple[float, ...]:
    shares = tuple(positive(WHO, "gains", gain) for gain in gains)
    if not shares or any(b <= a for a, b in pairwise(shares)):
        raise InputError(f"{WHO}: 'gains' must rise, got {tuple(gains)}.")
    return shares
