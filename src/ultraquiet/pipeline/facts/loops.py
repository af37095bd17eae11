"""What the stages of controllers and loops found out, in figures and words: one frozen dataclass a stage.

Frequencies are in Hz, attenuations in dB and positive where it is quieter; `status` is a word and a sentence.
"""

from collections.abc import Mapping
from typing import Any, Literal

from ultraquiet.design.weights.loop_weights import LoopFunction
from ultraquiet.pipeline.facts.typed import Vector, fact
from ultraquiet.simulate.sensitivity.measured import is_heard_from
from ultraquiet.values.status import StatusWord

ONLY = "bench"  # the name of the one unit of a bench that knows no units


@fact
class LeastChange:
    """The smallest change of one channel that upsets a loop, by the channel's name; see `analyse.ChannelChange`."""

    channel: str
    kind: Literal["gain", "phase"]
    amount: float
    f_hz: float
    disk: float


@fact
class LoopMargins:
    """Margins at one end of the plant, see `analyse.EndMargins`: of every loop by itself, `(loops,)`, and of all."""

    gain_up_db: Vector
    gain_down_db: Vector
    phase_deg: Vector
    delay_s: Vector
    disk: Vector
    disk_all: float | None = None
    disk_all_hz: float | None = None
    least_change: LeastChange | None = None


@fact
class RecoveryFacts:
    """How near a recovered loop comes to its target at best, relative; `at` says at which end."""

    at: str
    least_relative_error: float


@fact
class DeliveredFacts:
    """What a law does for the loop with the design model, see `reduce.Delivered`; `tones_db` by frequency, in Hz."""

    peak_db: float
    worst_direction_band_db: float | None
    tones_db: Mapping[str, float]
    control_db: float
    rms_db: float | None = None
    disk: Mapping[str, float]


@fact
class Reduction:
    """What reducing a controller did to its loop; `ok` where nothing that was promised is lost."""

    from_states: int
    cost_before: float
    cost_after: float
    before: DeliveredFacts | None = None
    after: DeliveredFacts | None = None
    ok: bool = True
    status: str


@fact
class DesignSummary:
    """The law that runs, in short: `gamma` and `achieved` are of its design, all else is of what a reduction left."""

    method: str
    status: str
    ok: bool
    states: int
    gamma: float
    achieved: float
    peak_sensitivity_db: float
    margins: Mapping[str, LoopMargins]


@fact
class DesignFacts(DesignSummary):
    """Stage `design`. `law_margins` are those of the law that runs, after its reduction.

    `weights_on` are the functions of the loop that the cost weighs, whose weights stand beside the law; `details` are
    the method's own numbers, for readers; nothing here is decided by them.
    """

    residuals: Mapping[str, float]
    adaptive: bool
    law_margins: Mapping[str, LoopMargins]
    reduction: Reduction | None = None
    norm_without_control: float | None = None
    recovery: RecoveryFacts | None = None
    weights_on: tuple[LoopFunction, ...] = ()
    details: Mapping[str, Any]


@fact
class ToneLevels:
    """Amplitudes of a tone at the sensors, in their `units`: open, closed, and what noise alone would show.

    `command` is the amplitude that is sent, in `command_units`, one an actuator; `below_command_db` is
    -20 log10(closed / command) of these numbers, which counts the plant's own gain as well.
    """

    units: tuple[str, ...]
    open: Vector
    closed: Vector
    floor: Vector
    command: float
    command_units: tuple[str, ...]
    below_command_db: Vector


@fact
class ToneFacts:
    """One tone on the bench: the worst channel, every channel, the worst direction, and `levels` with their units.

    `open_v`, `closed_v`, `floor_v` and `paper_db` are older names of what is in `levels`, whatever the unit is.
    `settled`: whether its amplitude stood still while it was measured.
    """

    reduction_db: float
    paper_db: float
    reduction_db_per_channel: Vector
    paper_db_per_channel: Vector
    worst_direction_db: float | None
    open_v: Vector
    closed_v: Vector
    floor_v: Vector
    settled: bool = True
    levels: ToneLevels | None = None


@fact
class StableLoop:
    """A loop that settled on the bench; `tones` by frequency, in Hz; growth of its slowest mode, e-folds a second.

    Of `lines` of the sensitivity `lines_missing` were not measured; `lines_hidden` says which count at noise's bound.
    `broadband_db` is of the RMS of the worst sensor over `band_hz`, those with frequencies over theirs where it has
    lines; `required_band_db` is the worst direction over the band of the requirements, where that is another one.
    `heard_hz` are the lowest and the highest line.
    """

    stable: Literal[True] = True
    status: str
    tones: Mapping[str, ToneFacts]
    broadband_5_100_db: float | None
    broadband_10_60_db: float | None
    broadband_db: float | None = None
    band_hz: tuple[float, float]
    worst_direction_band_db: float
    peak_amplification_db: float
    mean_log_sensitivity_db: float
    required_band_db: float | None = None
    growth_per_s: float | None = None
    growth_hz: float | None = None
    lines: int | None = None
    lines_missing: int = 0
    lines_hidden: str | None = None
    heard_hz: tuple[float, float] | None = None

    def unheard(self, band_hz: tuple[float, float]) -> list[tuple[float, float]]:
        """Return the parts of a band in which there are no lines, nothing where what was heard is not known."""
        if self.heard_hz is None:
            return []
        (low, high), (first, last) = band_hz, self.heard_hz
        below = [] if is_heard_from(first, low) else [(low, min(first, high))]
        return below + ([] if is_heard_from(high, last) else [(max(last, low), high)])


def of_the_bench(unit: str) -> str:
    """Return what a unit is called in a sentence; that of a bench without units is the bench itself."""
    return "the bench" if unit == ONLY else unit


@fact
class UnstableLoop:
    """A loop of which nothing is known but `status`, which begins with why.

    It ran away, at once or under a disturbance, and `stable` is false; or it is not known whether it is stable; or it
    settled and noise hid all of it: then it is null.
    """

    stable: Literal[False] | None = False
    status: str
    growth_per_s: float | None = None
    growth_hz: float | None = None

    def __post_init__(self) -> None:
        if self.word != StatusWord.UNSTABLE.value:
            object.__setattr__(self, "stable", None)

    def on(self, name: str, unit: str) -> str:
        """Return what became of a law on a unit of the bench, in words."""
        where = of_the_bench(unit)
        if self.word == StatusWord.NOT_KNOWN.value:
            return f"whether {name} is stable on {where} is not known"
        if self.word == StatusWord.NOT_MEASURED.value:
            return f"{name} settles on {where}, where noise hides how quiet it is"
        return f"{name} is {self.word} on {where}"

    @property
    def word(self) -> str:
        """The word of the status."""
        return self.status.partition(":")[0]


@fact
class LoopFacts:
    """Stage `loop`: one controller on the bench of every unit, the first of the study first."""

    units: Mapping[str, StableLoop | UnstableLoop]

    @property
    def unbearable(self) -> str:
        """Say that the loop is unstable on the first unit; empty where it is not, or not known to be."""
        unit, loop = next(iter(self.units.items()), ("", None))
        return "" if loop is None or loop.stable is not False else f"the loop is unstable on {of_the_bench(unit)}"
