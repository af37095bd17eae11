"""What every polynomial structure is told: orders, delays, known parts, how the minimum is looked for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from ultraquiet._base.constraints import one_of, whole, yes_or_no
from ultraquiet._base.errors import InputError
from ultraquiet.identify.prediction_error.fit import Fit
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation, check_known, each, laid_out
from ultraquiet.identify.prediction_error.race import Search
from ultraquiet.identify.prediction_error.structure import Structure
from ultraquiet.identify.record_checks import exciting, usable
from ultraquiet.identify.searched_order import AUTO, Auto, SearchedOrder, Unasked
from ultraquiet.values import Record

HIGHEST_ORDER = 30
NOT_ASKED = Unasked(5)  # the paper's, section 3.2
LONGEST_DELAY = 1000
# Block rows of the starting subspaces. 40 alone finds the minimum of the 3.5 kHz reference truth in 98 of 100 records;
# on records of the simulated hexapod no single one does in more than 3 of 4 channels, these six together in 79 of 84.
HORIZONS = (40, 20, 10, 30, 60, 80)


@dataclass(frozen=True)
class PolynomialSettings(SearchedOrder):
    """Settings all polynomial structures share; what fits by them stands above and is handed them.

    The coefficients minimise V = 1/n sum_t e(t)^2, e = (D/C)(A y - sum_j B_j / F_j u_j), by Levenberg-Marquardt on the
    filtered gradient. C, D and F keep their roots inside the unit circle at every accepted step.

    Args:
        order: number of free coefficients of every polynomial; "auto" or None takes the one that the last third of the
            record prefers, see `order_choice`. 5 when absent, which the verdict then says.
        delay: samples from an input to its first effect (1: no direct feedthrough), one for all inputs or one for each.
        b_order: number of coefficients of B when it differs from `order`; likewise.
        horizons: block rows of the subspace models that the search starts from, the most trusted first. A longer one
            sees slower modes, a shorter one is steadier.
        initial: "estimate" fits the past before the first sample, "rest" takes it as zero. Zero inflates the loss 2 to
            183 times at 3.5 kHz when the noise had begun before the record.
        offset: whether a constant at the output is fitted too.
        max_iterations: accepted steps before the search gives up.
        repair: whether readings at a sensor's limits (`Channel.low`, `Channel.high`) are taken for what they are: the
            truth lies further out. They are replaced by the model's own output, in rounds. `details["repaired"]` counts
            them; `fit_percent` is then judged on the model's output cut at the same limits.
        zeros_at_dc: known zeros at z = 1, B = (1 - q^-1)^k B': a geophone does not see what stands still. They count
            among the coefficients of B.
        known_poles: poles in z that every denominator is known to have, in conjugate pairs.
        fixed: whole polynomials that are known, {"c": [1.0, -0.9]} for instance, by the letters a, b, c, d, f.
    """

    name: ClassVar[str]

    order: int | Auto | None = NOT_ASKED
    delay: int | Sequence[int] = 1
    b_order: int | Sequence[int] | None = None
    horizons: tuple[int, ...] = HORIZONS
    initial: str = "estimate"
    offset: bool = True
    max_iterations: int = 100
    repair: bool = True
    zeros_at_dc: int = 0
    known_poles: Sequence[complex] = ()
    fixed: Mapping[str, Sequence[float]] | None = None

    def __post_init__(self) -> None:
        self.settle_order(HIGHEST_ORDER)
        who = type(self).__name__
        for name in ("delay", "b_order", "f_order"):
            value = getattr(self, name, None)
            if (value is None and name == "delay") or (isinstance(value, Sequence) and not len(value)):
                raise InputError(f"{who}: '{name}' must be a whole number, or one for each input, got {value!r}.")
        for delay in each(self.delay):
            whole(who, "delay", delay, 0, LONGEST_DELAY)
        for name in ("b_order", "c_order", "d_order", "f_order"):
            for value in each(getattr(self, name, None)):
                whole(who, name, value, 1 if name == "b_order" else 0, HIGHEST_ORDER)
        if not isinstance(self.horizons, Sequence) or not self.horizons:
            raise InputError(f"{who}: 'horizons' must be a list of at least one whole number, got {self.horizons!r}.")
        for rows in self.horizons:
            whole(who, "horizons", rows, 2)
        for name in ("offset", "repair"):
            yes_or_no(who, name, getattr(self, name))
        one_of(who, "initial", self.initial, ("estimate", "rest"))
        whole(who, "max_iterations", self.max_iterations, 1)
        if self.given_order is None:
            self.at_order(1)  # whichever order the record prefers, the other settings are known now
        else:
            check_known(self)

    @property
    def whole_order(self) -> int:
        """The order as a number.

        Raises:
            InputError: it is left to a record, and none has been asked yet.
        """
        if self.given_order is None:
            raise InputError(
                f"{type(self).__name__}: 'order' is '{AUTO}' and there is no record here to say it; give it a number."
            )
        return int(self.given_order)

    def at_order(self, order: int) -> Self:
        """Return the settings with another order."""
        return replace(self, order=order)

    def structure(self) -> Structure:
        """Return the numbers of coefficients."""
        raise NotImplementedError

    @property
    def informed(self) -> bool:
        """Whether inputs differ in order or delay, or parts of the polynomials are known."""
        settings = (self.delay, self.b_order, getattr(self, "f_order", None))
        return bool(
            any(isinstance(s, Sequence) for s in settings) or self.zeros_at_dc or len(self.known_poles) or self.fixed
        )

    def parameterisation(self, inputs: int) -> Parameterisation:
        """Return what is free and what is known of the polynomials of an output with so many inputs."""
        return laid_out(self, inputs)

    def for_input(self, j: int) -> Self:
        """Return the settings for input j alone."""
        given: dict[str, Any] = {name: getattr(self, name, None) for name in ("delay", "b_order", "f_order")}
        return replace(self, **{name: v[j] for name, v in given.items() if isinstance(v, Sequence)})

    def check(self, record: Record) -> None:
        """Refuse a record that cannot carry this structure."""
        structure = self.structure()
        memory = structure.delay + structure.a + structure.d
        usable(type(self).__name__, record, structure.parameters(record.inputs.shape[0]), memory)
        exciting(type(self).__name__, record, structure.a + structure.b + structure.f)

    def fit(self, data: ChannelData, rate_hz: float) -> Fit:
        """Return the model of one output."""
        raise NotImplementedError

    def search(self) -> Search:
        """Return how the minimum is looked for."""
        return Search(self.horizons, self.initial == "estimate", self.offset, self.max_iterations, self.repair)

    def _b(self) -> int:
        return self.whole_order if self.b_order is None else max(each(self.b_order))

    def _delay(self) -> int:
        return min(each(self.delay))
