"""Adaptive feedforward cancellation of tones whose frequencies are unknown and move."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import formerly, register
from ultraquiet._base.threads import single_threaded
from ultraquiet.design.result import STABLE_WORDS, DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.tones.adaptive_law import AdaptiveLaw, adapting, contiguous, limits_of
from ultraquiet.design.tones.bank import (
    SETTLED,
    Amplification,
    BankShape,
    facts,
    quiet_bank,
    resonators,
    timed,
    too_loud,
)
from ultraquiet.design.tones.inner_loop import Around, Inner, checked_tones, inner_loop, inverse, settlings
from ultraquiet.design.verification import judged
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

USUAL_S = 0.3  # of a tone, to settle
STATIONS = 5  # frequencies of the span at which the linear law must be stable
MARGIN_BINS = 5  # bins outside the span, which only tell how loud it is without a tone
MOST_BINS = 56  # inside
EVERY = 16  # samples between two looks at the bank
FOUND, GONE = 12.0, 4.0  # power of the loudest bin over the mean of the others: there from the one, until the other
JUMPED = 0.25  # a tone is lost when its own bin has less than this share of the loudest one's power
TABLE_POINTS = (17, 33, 65, 129, 257)
TABLE_ERROR = 0.02  # of the inverse half-way between points, relative


@register("design", "adaptive-feedforward")
@formerly(limit_v="limit")
@dataclass(frozen=True)
class AdaptiveFeedforward(StatedRobustness):
    """A law that finds tones in the readings, follows their frequencies and cancels them in every direction.

    y0 = y - G u, the readings as they would be without the law; a bank of narrow filters over each tone's span finds
    the tone in y0, a frequency-locked loop follows it, w(t), and a resonator that moves with it cancels it:
    u = sum Re(zeta), zeta+ = e^jw(t) (rho zeta - 2 a G(w(t))^-1 y). At a constant frequency this is the linear law of
    `Resonators`. Without a tone in its span a resonator fades and its command is zero.

    Args:
        tones_hz: nominal frequencies, Hz; at least one.
        span: how far each may be from its nominal frequency, as a share of that.
        settling_s: time of the amplitudes to within two per cent, one number or one a tone; a law that is slower at its
            nominal tones is `short`. When absent three tenths of a second are tried, and what came of it is said.
        track_hz: bandwidth of the loop that follows the frequency, Hz. As given it follows a drift in much noise; of
            a loud tone that jumps a twentieth to a fifth of its frequency meets it sooner.
        find_s: how long the bank listens.
        limit: largest command of the law per actuator, in its unit; its own when absent. Amplitudes that would exceed
            it are shrunk together.
        depth_db, peak_db, weakest, around, loop_peak_db: as those of `Resonators`.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=1000.0)
    >>> result = AdaptiveFeedforward(tones_hz=(30.0,), limit=5.0).design(plant)
    >>> result.law.step([0.0]).tolist(), result.controller.states
    ([0.0], 2)

    Bodson and Douglas 1997, doi:10.1016/S0005-1098(97)00149-0; Mojiri and Bakhshai 2004, doi:10.1109/TAC.2003.821414.
    """

    tones_hz: tuple[float, ...] = ()
    span: float = 0.1
    settling_s: float | tuple[float, ...] | None = None
    track_hz: float = 1.0
    find_s: float = 0.5
    limit: float | tuple[float, ...] | None = None
    depth_db: float = 60.0
    peak_db: float = 3.0
    weakest: float = 0.01
    around: Around = None
    loop_peak_db: float | None = None

    asks_limit: ClassVar[bool] = True  # a study gives it what it knows

    def __post_init__(self) -> None:
        super().__post_init__()
        settlings("AdaptiveFeedforward", self.settling_s, USUAL_S, len(np.atleast_1d(self.tones_hz)))
        for name in ("track_hz", "find_s", "depth_db", "peak_db"):
            positive("AdaptiveFeedforward", name, getattr(self, name))
        if self.loop_peak_db is not None:
            positive("AdaptiveFeedforward", "loop_peak_db", self.loop_peak_db)
        between("AdaptiveFeedforward", "span", self.span, 0.0, 0.5)
        between("AdaptiveFeedforward", "weakest", self.weakest, 0.0, 1.0)

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the law of a discrete plant: `law` adapts, `controller` is the linear law at the nominal tones.

        `details` as those of `Resonators` at the nominal tones, and `span_hz`, the frequencies searched per tone. The
        linear law is stable and amplifies by `peak_db` at most at each of five stations of the span.

        Raises:
            InputError: no tone, a tone or the end of its span outside (0, rate / 2), spans that overlap, no gain at a
                tone, an unstable plant, a controller that does not fit, an actuator without a limit.
        """
        who = "AdaptiveFeedforward"
        inner = inner_loop(who, plant, self.around)
        rate = inner.seen.rate_hz
        assert rate is not None
        tones = checked_tones(who, self.tones_hz, rate)
        edges = self._edges(tones, rate)
        most = Amplification(self.peak_db, self.loop_peak_db)
        refusal = too_loud(who, inner, most)
        if refusal:
            return refused(refusal)
        times, shape = settlings(who, self.settling_s, USUAL_S, tones.size), BankShape(self.depth_db)
        slowed = self._slowed(inner, tones, times, most)
        if slowed is None:
            return refused(f"{who}: no bank keeps below {most} of amplification over the whole span.")
        inverses = [inverse(who, inner.seen, f, self.weakest) for f in tones]
        limit = limits_of(who, self.limit, plant.actuators)
        speeds = SETTLED / (times * slowed * rate)
        bank = resonators(tones, inverses, rate, speeds, shape)
        details: dict[str, Any] = {
            **facts(inner, bank, tones, inverses, shape),
            "slowed": dict(zip(tones.tolist(), slowed.tolist(), strict=True)),
            "span_hz": {f: tuple(e) for f, e in zip(tones.tolist(), edges.tolist(), strict=True)},
        }
        result = judged(plant, inner.joined(bank), self, float("nan"), float("nan"), {}, details)
        if result.status.word not in STABLE_WORDS or result.controller is None:
            return result
        law = FeedforwardLaw(self, inner, result.controller, tones, edges, speeds, limit)
        return adapting(timed(result, times, self.settling_s is not None, most), law)

    def _edges(self, tones_hz: FloatArray, rate_hz: float) -> FloatArray:
        edges = np.stack([tones_hz * (1 - self.span), tones_hz * (1 + self.span)], axis=1)
        if edges.max() >= rate_hz / 2:
            raise InputError(
                f"AdaptiveFeedforward: the span of a tone ends at {edges.max():g} Hz, not below half the rate, "
                f"{rate_hz / 2:g} Hz."
            )
        ordered = edges[np.argsort(tones_hz)]
        for (_, end), (start, _) in pairwise(ordered.tolist()):
            if start <= end:
                raise InputError(
                    f"AdaptiveFeedforward: the spans of two tones share {start:g} to {end:g} Hz; make 'span' smaller."
                )
        return edges

    def _slowed(self, inner: Inner, tones_hz: FloatArray, times: FloatArray, most: Amplification) -> FloatArray | None:
        """Return how much slower than the times asked for each tone must be over the whole span."""
        slowed, shape = np.ones(tones_hz.size), BankShape(self.depth_db)
        for share in np.linspace(1 - self.span, 1 + self.span, STATIONS if self.span else 1):
            moved = tones_hz * share
            inverses = [inverse("AdaptiveFeedforward", inner.seen, f, self.weakest) for f in moved]
            bank, slowed, _ = quiet_bank(inner, moved, inverses, times, shape, most, slowed)
            if bank is None:
                return None
        return slowed


class FeedforwardLaw(AdaptiveLaw):
    """The law that runs; `tones_hz` are the frequencies that it follows now, nan where it hears no tone."""

    def __init__(
        self,
        settings: AdaptiveFeedforward,
        inner: Inner,
        law: StateSpace,
        tones_hz: FloatArray,
        edges_hz: FloatArray,
        speeds: FloatArray,
        limit: FloatArray,
    ) -> None:
        rate = inner.seen.rate_hz
        assert rate is not None
        self._system = contiguous(inner.seen)
        bins, searched, rates = _bank(edges_hz, settings.find_s, rate)
        rho = 1 - speeds / 10 ** (settings.depth_db / 20)
        p = 2 * np.pi * settings.track_hz  # of the copy's own loop, rad/s; the frequency's is half as quick
        k = 2 * p / rate
        gains = np.array([k, k * (p / 2) / rate, k * (p / 2) ** 2 / 4 / rate**2])
        turns = 2 * np.pi / rate
        self._design = (
            bins * turns,
            searched,
            rates,
            np.array([FOUND, GONE, JUMPED]),
            gains,
            edges_hz * turns,
            np.ascontiguousarray(np.stack([speeds, rho, 1 - speeds], axis=1)),
            _table(inner.seen, edges_hz, settings.weakest),
            limit,
            EVERY,
        )
        self._nominal = tones_hz * turns
        super().__init__("AdaptiveFeedforward", inner, law, limit)

    @property
    def tones_hz(self) -> FloatArray:
        """Frequencies followed now, Hz, `(nt,)`."""
        w, _, on, _ = self._follow
        return np.where(on == 1, w * self._rate / (2 * np.pi), np.nan)

    def _start(self) -> None:
        bins = self._design[0]
        nu, ny = self._inner.first.D.shape
        nt, nb = bins.shape
        n = self._inner.seen.states
        self._follow = self._nominal.copy(), np.zeros(nt), np.zeros(nt, dtype=np.int64), np.zeros(nt)
        bank = (
            np.ones((nt, nb), dtype=np.complex128),
            np.zeros((nt, nb, ny), dtype=np.complex128),
            np.zeros((nt, nb, ny), dtype=np.complex128),
            np.zeros((nt, nb)),
        )
        copies, amplitudes = np.zeros((nt, ny), dtype=np.complex128), np.zeros((nt, nu), dtype=np.complex128)
        self._state = (
            np.zeros(n),
            np.zeros(n),
            np.zeros(1, dtype=np.int64),
            bank,
            self._follow,
            copies,
            amplitudes,
            np.zeros(ny),
            np.zeros(ny),
        )

    def _adapt(self, y: FloatArray) -> int:
        from ultraquiet.design.tones.kernels import feedforward_step

        return feedforward_step(y, self._system, self._design, self._state, self._v, self._y0)


def _bank(edges_hz: FloatArray, find_s: float, rate_hz: float) -> tuple[FloatArray, Any, FloatArray]:
    """Return bins in Hz `(nt, nb)`, the range of those searched `(nt, 2)` and the filters' rates `(nt,)`.

    Two stages of one time constant each listen for `find_s` together; bins stand one bandwidth apart, further where
    there would be too many, the filters then as much wider.
    """
    widths = edges_hz[:, 1] - edges_hz[:, 0]
    spacing = np.maximum(1.0 / (np.pi * find_s), widths / MOST_BINS)
    inside = int(np.ceil((widths / spacing).max())) + 1
    count = inside + 2 * MARGIN_BINS
    middle = edges_hz.mean(axis=1)
    bins = middle[:, None] + spacing[:, None] * (np.arange(count) - (count - 1) / 2)
    searched = [
        (int(np.argmax(row >= low - step / 2)), int(np.flatnonzero(row <= high + step / 2)[-1]) + 1)
        for row, (low, high), step in zip(bins, edges_hz, spacing, strict=True)
    ]
    return bins, np.array(searched, dtype=np.int64), 2 * np.pi * spacing / rate_hz


def _table(system: StateSpace, edges_hz: FloatArray, weakest: float) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Return G^-1 `(nt, points, nu, ny)` over each span, its start and step in rad per sample."""
    assert system.rate_hz is not None
    tables: list[ComplexArray] = []
    for points in TABLE_POINTS:
        fine = [_inverses(system, np.linspace(low, high, 2 * points - 1), weakest) for low, high in edges_hz]
        tables = [f[::2] for f in fine]
        errors = [_halfway_error(f) for f in fine]
        if max(errors) < TABLE_ERROR:
            break
    turns = 2 * np.pi / system.rate_hz
    width = np.maximum(edges_hz[:, 1] - edges_hz[:, 0], np.finfo(float).eps * edges_hz[:, 0])
    return np.stack(tables), edges_hz[:, 0] * turns, width * turns / (tables[0].shape[0] - 1)


def _inverses(system: StateSpace, f_hz: FloatArray, weakest: float) -> ComplexArray:
    return np.array([inverse("AdaptiveFeedforward", system, f, weakest).matrix for f in f_hz])


def _halfway_error(fine: ComplexArray) -> float:
    between_points = (fine[:-2:2] + fine[2::2]) / 2
    gap = np.linalg.norm(between_points - fine[1::2], axis=(1, 2))
    return float((gap / np.linalg.norm(fine[1::2], axis=(1, 2))).max())
