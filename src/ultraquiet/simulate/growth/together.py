"""The growth of modes that one record leaves in doubt, from many records of the same loop together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.frames import OVERLAP, Frames
from ultraquiet.simulate.free_response import (
    APART,
    CERTAIN,
    LASTING,
    LEAKED,
    RESOLUTION,
    ROUNDING,
    WIDE,
    Mode,
    hz_of,
    turned,
)
from ultraquiet.simulate.growth.coincident import widened
from ultraquiet.simulate.kick import FreeResponse

# Other distances of frames that must tell the same of a mode, within its deviation: where a band holds more modes than
# directions, each distance makes something else of them.
OTHERS_APART = (APART + 2, APART + 4, APART + 6)
# What a burst left is judged alone where its power is so many times that of the noise.
HEARD = 3.0
# A record ends where a command uses this share of its range. A frame's window has next to nothing so many steps before
# its middle, and nothing so many after it.
NEARLY, AFTER, FURTHER = 0.8, 3, 5
# A direction of the channels holds a mode when what is heard in it is so many times the most that noise shows in any.
ABOVE, MOST_TOGETHER = 1.5, 6


@dataclass(frozen=True, eq=False)
class Together:
    """Bands of several records about the frequencies in doubt.

    Args:
        frames: how each record is cut.
        f_hz: the frequencies.
        unit: of every channel, its noise in the first record, `(channels,)`.
        response, noise: of every band `(records, channels, frames)`.
        used: of every record, how many frames count, `(records,)`.
        touched: in how many records a command touched its limit within them, or would have.
        powers: of early and late noise, `(2, channels)`, summed over the records.
        loudest: largest amplitude of the responses in any band.
    """

    frames: Frames
    f_hz: tuple[float, ...]
    unit: FloatArray | None = None
    response: tuple[ComplexArray, ...] = ()
    noise: tuple[ComplexArray, ...] = ()
    used: tuple[int, ...] = ()
    touched: int = 0
    powers: FloatArray | None = None
    loudest: float = 0.0

    @property
    def lines(self) -> tuple[int, ...]:
        """The bands' lines."""
        return tuple(dict.fromkeys(round(f / self.frames.line_hz(1)) for f in self.f_hz))

    @property
    def records(self) -> int:
        """How many records there are."""
        return len(self.response[0]) if self.response else 0

    def beside(self, record: FreeResponse) -> "Together":
        """Return them with those of one more record."""
        unit = _unit(record) if self.unit is None else self.unit
        scaled = (record.response / unit[:, None], record.noise / unit[:, None])
        bands = [[self.frames.band(x, line)[None] for line in self.lines] for x in scaled]
        if self.response:
            pairs = [
                zip(known, new, strict=True) for known, new in zip((self.response, self.noise), bands, strict=True)
            ]
            bands = [[np.concatenate(pair) for pair in part] for part in pairs]
        used, touched = _until(self.frames, record)
        grown = powers(record.noise) if used == self.frames.count else np.zeros((2, unit.size))
        return replace(
            self,
            unit=unit,
            response=tuple(bands[0]),
            noise=tuple(bands[1]),
            used=(*self.used, used),
            touched=self.touched + touched,
            powers=grown + (0.0 if self.powers is None else self.powers),
            loudest=max(self.loudest, float(np.sqrt(self.frames.power(scaled[0], 0).max()))),
        )

    @property
    def rise(self) -> float:
        """By how much noise grew within the records."""
        return 0.0 if self.powers is None else rise(self.powers)

    def modes(self) -> tuple[tuple[Mode, ...] | None, ...]:
        """Return the modes of every band, as `growths`."""
        return tuple(
            growths(self.frames, line, b, e, self.used, np.sqrt(LEAKED) * self.loudest)
            for line, b, e in zip(self.lines, self.response, self.noise, strict=True)
        )


def _until(frames: Frames, record: FreeResponse) -> tuple[int, bool]:
    """Return how many frames of a record count, and whether a command touched its limit within them.

    A record ends where a command first uses a large share of its range. All that led there is in the frames whose
    middle is a little later, so that to end there favours neither growth nor decay; they reach a little further yet.
    """
    hop, middle = frames.hop, frames.length // 2
    near, touched = record.before(NEARLY), record.before_limits
    ends = frames.count if near == frames.samples else (near + AFTER * hop - middle) // hop + 1
    free = frames.count if touched == frames.samples else (touched - FURTHER * hop - middle) // hop + 1
    return int(np.clip(min(ends, free), 0, frames.count)), free < min(ends, frames.count)


def _unit(record: FreeResponse) -> FloatArray:
    """Return what each channel is measured in: its noise, or what rounding leaves of it; one where it is silent."""
    unit = np.maximum(np.sqrt(np.mean(record.noise**2, axis=1)), ROUNDING * np.abs(record.response).max(axis=1))
    return np.where(unit > 0, unit, 1.0)


def powers(noise: FloatArray) -> FloatArray:
    """Return the power of the second and of the last quarter of each channel, `(2, channels)`."""
    quarter = noise.shape[1] // 4
    parts = (noise[:, quarter : 2 * quarter], noise[:, -quarter:])
    return np.array([np.mean(part**2, axis=1) for part in parts])


@np.errstate(over="ignore")  # over nothing at all
def rise(powers: FloatArray) -> float:
    """Return the largest ratio of late to early amplitudes."""
    early, late = np.sqrt(powers)
    heard = late > 0
    return float(np.max(late[heard] / np.maximum(early[heard], np.finfo(float).tiny), initial=0.0))


def growths(
    frames: Frames,
    line: int,
    response: ComplexArray,
    noise: ComplexArray,
    lengths: Sequence[int],
    leaked: float = 0.0,
) -> tuple[Mode, ...] | None:
    """Return the modes of one band of several records, each with its growth and how well it is known.

    Reading noise that the law feeds back drives a slow mode as much as it blurs it: from frame to frame its amplitude
    is x_{k+1} = Z x_k + w_k, w_k what noise fed it meanwhile. An error that sums up like this leaves least squares of
    the whole shape behind; what is known best is each step by itself,

        Z = (sum x_{k+1} v_k*) (sum x_k v_k*)^-1,   v_k = x_{k - 8},

    summed over all frames of all records. v_k shares no sample with w_k, nor with what the readings' noise adds to x_k,
    so that neither moves Z (instrumental variables, Ljung 1999, section 7.6); its deviation follows from the power of
    the steps' own errors, in the response and in the noise alike. With an amplitude M of the mode and N frames, it is
    that of the largest information, |w| / (M sqrt(2 N)), and falls with the root of the number of records.

    Args:
        frames: how the records were cut.
        line: the band's.
        response: `(records, channels, frames)`.
        noise: likewise, what the same loops did without a burst.
        lengths: how many frames of each record count, `(records,)`.
        leaked: largest amplitude that may have come from other bands.

    Returns:
        Modes near the middle of the band; empty where nothing lasts, None where no frame counts.
    """
    skipped = frames.count // 8
    used = np.arange(frames.count) < np.asarray(lengths)[:, None]
    if line == 0:
        noise = _without_rest(noise, used)
    b, e = (np.concatenate((x * used[:, None])[..., skipped:], axis=-1) for x in (response, noise))
    if not np.abs(b).max() > 0:
        return None
    if not np.abs(b).max() > leaked:
        return ()
    left, sizes, _ = np.linalg.svd(b, full_matrices=False)
    order = int(np.clip(np.count_nonzero(sizes > ABOVE * np.linalg.norm(e, 2)), 1, MOST_TOGETHER))
    floor = RESOLUTION * float(max(np.abs(b).max(), np.abs(e).max()))
    while order:
        along = left[:, :order].conj().T
        power, hum = (float(np.sum(np.abs(along @ part) ** 2)) for part in (b, e))
        x, w = (along @ part[..., skipped - APART :] for part in (response, noise))
        steps = _Steps(x, w, used[:, None, skipped - APART :], line == 0 or power > HEARD * hum)
        if steps.lasting:
            return _modes(frames, line, steps, floor, len(left))
        order -= 1
    return ()


def _without_rest(noise: ComplexArray, used: NDArray[np.bool_]) -> ComplexArray:
    """Return the noise at 0 Hz without where each record comes to rest, which is known better here than before."""
    counted = used[:, None]
    return noise - np.sum(noise * counted, axis=-1, keepdims=True) / np.maximum(counted.sum(axis=-1, keepdims=True), 1)


@dataclass(frozen=True, eq=False)
class _Steps:
    """Steps of x, the response, and w, the noise, `(records, directions, frames)`; `used`, those that count.

    What noise rang tells as much where it is as loud; a hum or an offset in it would hide the decay of anything, so
    that what is heard well above it, or at 0 Hz, is judged `alone`.
    """

    x: ComplexArray
    w: ComplexArray
    used: NDArray[np.bool_]
    alone: bool

    @cached_property
    def moments(self) -> tuple[ComplexArray, ...]:
        """Return the sums of x_{k+1} v*, x_k v*, v v* and x_k x_k*, v = x_{k - 8}."""
        return self.moments_apart(APART)

    def moments_apart(self, apart: int) -> tuple[ComplexArray, ...]:
        """Return the same sums with v = x_{k - apart}."""
        counted = self.used[..., apart + 1 :]
        total = np.zeros((4, self.x.shape[1], self.x.shape[1]), dtype=np.complex128)
        for part in (self.x,) if self.alone else (self.x, self.w):
            after, now, before = (
                part[..., apart + 1 :],
                part[..., apart:-1] * counted,
                part[..., : -apart - 1] * counted,
            )
            pairs = ((after, before), (now, before), (before, before), (now, now))
            total += [np.einsum("rik,rjk->ij", a, b.conj()) for a, b in pairs]
        return tuple(total)

    def poles_apart(self) -> list[ComplexArray]:
        """Return the poles that other distances of frames make of the same steps."""
        sums = (self.moments_apart(apart) for apart in OTHERS_APART)
        steps = (np.linalg.lstsq(held.T, after.T)[0].T for after, held, _, _ in sums)
        return [np.linalg.eigvals(z).astype(np.complex128) for z in steps]

    @property
    def lasting(self) -> bool:
        """Whether every direction keeps its share over the steps between: else there are no modes to tell."""
        _, held, spread, kept = self.moments
        sides = [np.linalg.eigh(part) for part in (kept, spread)]
        if any(not values[0] > 1e-15 * values[-1] for values, _ in sides):
            return False
        left, right = (vectors / np.sqrt(values) for values, vectors in sides)
        return bool(np.linalg.svd(left.conj().T @ held @ right, compute_uv=False)[-1] > LASTING)

    def errors(self, z: ComplexArray) -> list[ComplexArray]:
        """Return what each step of the response and of the noise leaves."""
        counted = self.used[..., APART + 1 :]
        return [(part[..., APART + 1 :] - z @ part[..., APART:-1]) * counted for part in (self.x, self.w)]


def _modes(frames: Frames, line: int, steps: _Steps, floor: float, channels: int) -> tuple[Mode, ...]:
    """Return the modes of one band from the steps of its directions."""
    after, held, spread, _ = steps.moments
    inverse = np.linalg.inv(held)
    z = after @ inverse
    poles, shapes = np.linalg.eig(z)
    errors, others = steps.errors(z), steps.poles_apart()
    share = float(np.mean(steps.used[..., APART + 1 :]))  # of the steps that count
    students = _students(2 * share * errors[0][:, 0].size)
    per_s = frames.rate_hz / frames.hop
    found: list[Mode] = []
    rates: list[complex] = []
    for pole, shape, row in zip(poles, shapes.T, np.linalg.inv(shapes), strict=True):
        if not abs(pole) > 0 or abs(turned(frames, line, pole)) > WIDE * np.pi / 2:
            continue
        back = np.exp(-1j * np.angle(pole) * np.arange(errors[0].shape[-1]))
        power = float(np.mean([_long_run(np.einsum("i,rik->rk", row, error) * back) for error in errors])) / share
        reach = inverse @ shape
        variance = (power + floor**2) * float(np.real(reach.conj() @ spread @ reach)) / 2
        size, hum = (float(np.linalg.norm(np.einsum("i,rik->rk", row, part))) for part in (steps.x, steps.w))
        growth, deviation = (float(part * per_s) for part in (np.log(abs(pole)), np.sqrt(variance) / abs(pole)))
        told = [float(np.log(max(abs(other[np.argmin(abs(other - pole))]), np.finfo(float).tiny))) for other in others]
        disagree = max(abs(other * per_s - growth) for other in told)
        deviation = float(np.hypot(students * deviation, max(disagree - deviation, 0.0)))
        seen = size / max(hum, ROUNDING * size)
        found.append(Mode(growth, deviation, hz_of(frames, line, complex(pole)), seen))
        rates.append(complex(np.log(complex(pole)) * per_s))
    modes = widened(found, np.array(rates, dtype=np.complex128), channels, real=line == 0)
    return tuple(sorted(modes, key=lambda mode: -mode.growth_per_s))


def _students(values: float) -> float:
    """Return by how much a deviation found from few errors must rise to be as rarely exceeded `CERTAIN` times.

    t / z = 1 + (z^2 + 1) / (4 nu) for the quantiles of Student and Gauss (Abramowitz and Stegun 1972, 26.7.5), with
    nu = 3 n / B degrees of freedom of a power at zero frequency from n complex values and B lags.
    """
    freedom = 3.0 * values / OVERLAP
    return 1.0 + (CERTAIN**2 + 1.0) / (4.0 * freedom)


def _long_run(error: ComplexArray) -> float:
    """Return the power at zero frequency of an error `(records, frames)` whose neighbours share a window."""
    count = error.shape[-1]
    total = float(np.mean(np.abs(error) ** 2))
    for lag in range(1, min(OVERLAP, count - 1)):
        shared = float(np.mean(np.real(error[:, lag:] * error[:, :-lag].conj())))
        total += 2 * (1 - lag / OVERLAP) * shared
    return max(total, float(np.mean(np.abs(error) ** 2)) / OVERLAP)
