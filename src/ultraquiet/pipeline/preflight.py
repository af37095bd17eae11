"""What a study asks of its bench and of its experiment list, checked before anything moves."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np

from ultraquiet import simulate
from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet._base.lines import Place
from ultraquiet._base.mistakes import Mistakes
from ultraquiet._base.registry import lookup
from ultraquiet._base.shown.line import counted, several_of
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.bench.inner import Around
from ultraquiet.design.mean_channel import WOULD_DO
from ultraquiet.experiments import ExperimentList
from ultraquiet.pipeline.facts.loops import ONLY
from ultraquiet.pipeline.identification import grouped, one_record_of, recorded
from ultraquiet.pipeline.study import Band, ClosedLoop, IdentifyTable, Plant, Study, StudyError
from ultraquiet.simulate.attenuation import shortest_run_s, slowest_tone_hz
from ultraquiet.simulate.payload.wires import place_of
from ultraquiet.values import Channel, StateSpace
from ultraquiet.values.channel import usual_level

FEWEST_PERIODS = 3  # of a record that a response is made of
SHORTEST_S, PERIODS = 2.0, 20.0  # of tones: this long, and this many periods of the lowest
HEARD = 0.4  # of a sensor's range: tones that nobody gave an amplitude stay below, before a law is closed
MOST_SAMPLES = 1e8  # of all channels of one run; 0.8 GB


def check(
    study: Study,
    bench: Any,
    names: Sequence[str] | None,
    plan: ExperimentList | None = None,
    seen: Any = None,
    noted: Mistakes | None = None,
) -> None:
    """Refuse units and tones that the bench does not have, and records that neither experiment nor files leave.

    With the list that is to be run a period is held against that of its signals. Bands, tones, lengths and what is said
    channel by channel are held against `seen`, a bench or record of the channels and the rate that laws have; the bench
    itself when absent. What was `noted` before is told with it; without names nothing is said of records.

    Raises:
        StudyError: every mistake, in one message.
    """
    mistakes = study.mistakes() if noted is None else noted
    if study.plant.units and (study.bench is None or (bench is not None and not reacts(bench))):
        fault = "no bench of this study could be another unit; leave it away."
        mistakes.add(("plant", "units"), f"plant.units: {fault}")
    if bench is not None and not reacts(bench):
        _played(study, mistakes)
    elif bench is not None:
        _closed_loop(study, bench, mistakes)
        _payload(study, bench, mistakes)
        _campaign(study, bench, mistakes)
    if names is not None:
        _records(study, names, mistakes)
    wired = bench if seen is None else seen
    if wired is not None:
        _below_nyquist(study, wired.rate_hz, "the records'" if bench is None else "the bench's", mistakes)
        _channels(study, wired, mistakes)
        _lengths(study, wired, mistakes)
        _shapes(study, wired, mistakes)
    if plan is not None:
        _period(study, plan, mistakes)
    mistakes.refuse(StudyError, study.name)


def reacts(bench: Any) -> bool:
    """Return whether a bench answers what a controller does; one that plays records back does not."""
    return reacts(bench.bench) if isinstance(bench, Around) else getattr(bench, "reacts", True)


def _played(study: Study, mistakes: Mistakes) -> None:
    """Note what a study asks to be measured in closed loop on a bench that only plays back."""
    fault = "the bench plays back its records and cannot react to a controller; leave it away."
    asked = study.requirements
    for name in ("closed_loop", "payload", "commission", "campaign"):
        if name in study.model_fields_set:
            mistakes.add((name,), f"{name}: {fault}")
    for key in ("attenuation_db", "peak_db", "tones_db", "payload_db"):
        if asked is not None and getattr(asked, key) is not None:
            mistakes.add(("requirements", key), f"requirements.{key}: {fault}")


@dataclass(frozen=True)
class LoopPlan:
    """What is measured of every law, all of it known: `[closed_loop]` with what the bench and the plant add.

    `amplitude` is in the actuators' unit.
    """

    units: tuple[str, ...]
    tones_hz: tuple[float, ...]
    amplitude: float
    duration_s: float
    band_hz: Band


def loop_plan(settings: ClosedLoop, bench: Any, plant: StateSpace) -> LoopPlan:
    """Return `[closed_loop]` with everything that it leaves to the bench and to the plant."""
    tones = tuple(settings.tones_hz)
    return LoopPlan(
        units=units_of(settings, bench),
        tones_hz=tones,
        amplitude=settings.amplitude or _heard_within_range(usual_amplitude(bench), bench, plant, tones),
        duration_s=settings.duration_s or max(SHORTEST_S, PERIODS / min(tones, default=PERIODS)),
        band_hz=settings.band_hz or even_plant(plant, who="closed_loop").band_hz,
    )


def units_of(settings: ClosedLoop, bench: Any) -> tuple[str, ...]:
    """Return the names of the units that are measured; the bench as it stands where the study names none."""
    return tuple(settings.units) or (getattr(bench, "unit", ONLY),)


def as_unit(bench: Any, unit: str) -> Any:
    """Return the bench as another unit of its kind.

    Raises:
        InputError: the bench knows no units, or not this one.
    """
    if is_dataclass(bench) and not isinstance(bench, type) and any(f.name == "unit" for f in fields(bench)):
        return replace(bench, unit=unit)
    if isinstance(bench, Around):
        return replace(bench, bench=as_unit(bench.bench, unit))  # type: ignore[type-var]
    if unit not in (ONLY, getattr(bench, "unit", ONLY)):
        raise InputError(f"this bench knows no units, so none is '{unit}'; leave 'units' away.")
    return bench


def usual_amplitude(bench: Any) -> float:
    """Return a tenth of what its actuators may swing; one where none has limits."""
    return usual_level(getattr(bench, "actuators", ()))


def _heard_within_range(amplitude: float, bench: Any, plant: StateSpace, tones_hz: Sequence[float]) -> float:
    """Return the amplitude of tones on all actuators, lowered until no sensor needs more than a share of its range.

    Without a law, where the plant answers as it was identified: sum_j |G_ij(f)| a <= `HEARD` min(-low_i, high_i).
    """
    ranges = [min(-c.low, c.high) for c in getattr(bench, "sensors", ())]
    if not tones_hz or len(ranges) != len(plant.sensors) or not np.isfinite(ranges).any():
        return amplitude
    gains = np.abs(plant.frequency_response(np.array(tones_hz))).sum(axis=1).max(axis=1)
    most = min((HEARD * own / gain for own, gain in zip(ranges, gains, strict=True) if gain > 0 < own), default=np.inf)
    return min(amplitude, float(most))


def _closed_loop(study: Study, bench: Any, mistakes: Mistakes) -> None:
    for k, unit in enumerate(study.plant.units):
        try:
            as_unit(bench, unit)
        except UltraquietError as error:
            mistakes.add(("plant", "units", k), f"plant.units: {error}")
    for k, unit in enumerate(study.closed_loop.units):
        try:
            as_unit(bench, unit)
        except UltraquietError as error:
            mistakes.add(("closed_loop", "units", k), f"closed_loop.units: {error}")
    _levels(study.closed_loop, bench, mistakes)
    _periods(study.closed_loop, mistakes)


def _levels(asked: ClosedLoop, bench: Any, mistakes: Mistakes) -> None:
    """Note tones that the actuators cannot send."""
    for c in bench.actuators:
        most = min(c.high, -c.low)
        if asked.amplitude is not None and asked.amplitude > most:
            fault = (
                f"{asked.amplitude:g} is beyond the range of '{c.name}', {c.low:g} to {c.in_unit(c.high)}; ask less."
            )
            mistakes.add(("closed_loop", "amplitude"), f"closed_loop.amplitude: {fault}")
            break


def _periods(asked: ClosedLoop, mistakes: Mistakes) -> None:
    """Note runs of which the slowest tone would not fill the part that is measured with a period."""
    slowest_hz = min(asked.tones_hz, default=np.inf)
    if asked.duration_s is None or slowest_hz >= slowest_tone_hz(asked.duration_s):
        return
    fault = (
        f"{asked.duration_s:g} s are too short for a tone of {slowest_hz:g} Hz; ask for "
        f"{_rounded_up(shortest_run_s(slowest_hz)):g} s or more, or leave it away."
    )
    mistakes.add(("closed_loop", "duration_s"), f"closed_loop.duration_s: {fault}")


def _rounded_up(number: float) -> float:
    """Return a number of three digits that is no smaller.

    >>> _rounded_up(2.0), _rounded_up(1.53846), _rounded_up(2222.2)
    (2.0, 1.54, 2230.0)
    """
    digits = 2 - int(np.floor(np.log10(number)))
    near = round(number, digits)
    return near if near >= number else round(near + 10.0**-digits, digits)


def unheard(study: Study) -> list[str]:
    """Return the settings of `[closed_loop]` that only a bench could act on, of a study that closes no loop on one."""
    keys = ("units", "tones_hz", "amplitude", "duration_s")
    return [key for key in keys if key in study.closed_loop.model_fields_set]


def _below_nyquist(study: Study, rate_hz: float, whose: str, mistakes: Mistakes) -> None:
    """Note bands and tones, of tables and of designs, that end beyond half the rate."""
    for place, values in _frequencies(study):
        for k, f_hz in enumerate(values):
            if f_hz >= rate_hz / 2:
                name = ".".join(map(str, place))
                fault = f"{f_hz:g} Hz is not below half {whose} rate, {rate_hz / 2:g} Hz."
                mistakes.add((*place, k), f"{name}: {fault}")


def _frequencies(study: Study) -> Iterator[tuple[Place, Sequence[float]]]:
    """Yield the place of every band and of all tones of a study, with their frequencies in Hz."""
    tables = ("closed_loop", "validate_models", "requirements", "payload", "paper")
    for name in tables:
        for key in ("band_hz", "tones_hz"):
            place = ({"validate_models": "validate"}.get(name, name), key)
            yield place, getattr(getattr(study, name), key, None) or ()
    for k, band_hz in enumerate(study.limits.bands_hz):
        yield ("limits", "bands_hz", k), band_hz
    for name, design in study.controllers.items():
        for family in ("design", "reduce"):
            method = getattr(design, family)
            for key, value in {} if method is None else method.settings.items():
                if key.endswith(("band_hz", "tones_hz", "notches_hz")) and isinstance(value, tuple):
                    yield ("controllers", name, family, key), [f for f in value if isinstance(f, int | float)]


def _channels(study: Study, wired: Any, mistakes: Mistakes) -> None:
    """Note channels of one name, and what is said of channels that there are not."""
    for what, wires in (("actuators", wired.actuators), ("sensors", wired.sensors)):
        names = [c.name for c in wires]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:  # tables, figures and summary tell channels apart by name alone
            mistakes.add(("bench",), f"bench: two {what} are called '{twice}'; give each a name of its own.")
    nu, ny = len(wired.actuators), len(wired.sensors)
    limits = study.deploy.limits
    if isinstance(limits, list) and len(limits) not in (1, nu):
        given = f"{counted(len(limits), 'limit')}; give one number, or one an actuator."
        fault = f"{several_of(nu, 'there is', 'there are')} {counted(nu, 'actuator')} and {given}"
        mistakes.add(("deploy", "limits"), f"deploy.limits: {fault}")
    elif limits is not None:
        _narrower(np.broadcast_to(limits, nu).tolist(), wired.actuators, mistakes)
    if study.paper is not None and study.paper.channel > min(nu, ny):
        wires = f"{counted(nu, 'actuator')} and {counted(ny, 'sensor')}, counted from one."
        fault = f"there is no channel {study.paper.channel}: {wires}"
        mistakes.add(("paper", "channel"), f"paper.channel: {fault}")


def _narrower(limits: Sequence[float], actuators: Sequence[Channel], mistakes: Mistakes) -> None:
    """Note a limit of commands in code below that which an actuator states itself and its code keeps to."""
    for limit, c in zip(limits, actuators, strict=True):
        if limit < max(-c.low, c.high) < np.inf:
            fault = (
                f"{limit:g} is below the range of '{c.name}', {c.low:g} to {c.in_unit(c.high)}, which its code keeps "
                "to; these are for actuators without one: give the channel a narrower range, or leave it away."
            )
            mistakes.add(("deploy", "limits"), f"deploy.limits: {fault}")
            return


def _shapes(study: Study, wired: Any, mistakes: Mistakes) -> None:
    """Note designs that take square plants alone where there are not as many sensors as actuators."""
    ny, nu = len(wired.sensors), len(wired.actuators)
    for name, table in study.controllers.items() if ny != nu else ():
        kind = lookup("design", table.design.method)
        if table.around is None and hasattr(kind, "square_plants") and table.design.make("design").square_plants:
            fault = f"so set, '{table.design.method}' takes a square plant, here are {ny} sensors and {nu} actuators; "
            fault += WOULD_DO
            mistakes.add(("controllers", name, "design", "method"), f"controllers.{name}.design: {fault}")


def _lengths(study: Study, wired: Any, mistakes: Mistakes) -> None:
    """Note runs whose samples no memory holds."""
    longest_s = MOST_SAMPLES / (wired.rate_hz * (len(wired.actuators) + len(wired.sensors)))
    for name in ("closed_loop", "payload", "commission"):
        for key in ("duration_s", "seconds", "settle_s"):
            asked = getattr(getattr(study, name), key, None)
            if asked is not None and asked > longest_s:
                fault = f"{asked:g} s are more than memory holds at {wired.rate_hz:g} Hz; ask for {longest_s:.3g} s."
                mistakes.add((name, key), f"{name}.{key}: {fault}")


def _period(study: Study, plan: ExperimentList, mistakes: Mistakes) -> None:
    """Note a period that is not the one of the signals which the plant's records answer, or too long for them."""
    asked = study.plant.period_samples
    for measurement in plan.measurements:
        if asked is None or not {measurement.name, measurement.group} & set(study.plant.records):
            continue
        if measurement.samples < FEWEST_PERIODS * asked:
            fault = (
                f"{asked}, yet '{measurement.group}' is {counted(measurement.samples, 'sample')} long; a response "
                f"takes three periods, one to settle and two to tell noise from it: {FEWEST_PERIODS * asked} samples."
            )
            mistakes.add(("plant", "period_samples"), f"plant.period_samples: {fault}")
            return
        for drive in measurement.drives:
            sent = getattr(drive.signal, "period_samples", None)
            if isinstance(sent, int) and sent > 0 and asked % sent:
                fault = f"{asked}, yet '{measurement.group}' repeats after {sent} samples; give that period."
                mistakes.add(("plant", "period_samples"), f"plant.period_samples: {fault}")
                return


def _payload(study: Study, bench: Any, mistakes: Mistakes) -> None:
    """Note a payload that this bench cannot be listened to."""
    if study.payload is None:
        return
    try:
        tones_hz = [f for f in study.closed_loop.tones_hz if f < bench.rate_hz / 2]  # others are told where they stand
        heard = simulate.OpenPayload(bench, study.payload.setup(tones_hz)).bench
        force = [] if study.payload.force is None else [study.payload.force]
        sources = [place_of(name, heard.actuators, "payload", "actuator") for name in (study.payload.shaker, *force)]
    except UltraquietError as error:
        mistakes.add(("payload",), f"payload: {str(error).removeprefix('payload: ')}")
        return
    level = study.payload.level
    for c in (heard.actuators[k] for k in sources):
        if level is not None and level > min(c.high, -c.low):
            fault = f"{level:g} is beyond the range of '{c.name}', {c.low:g} to {c.in_unit(c.high)}; ask less."
            mistakes.add(("payload", "level"), f"payload.level: {fault}")
            return


def _campaign(study: Study, bench: Any, mistakes: Mistakes) -> None:
    """Note a bench that cannot be drawn, or not judged by a model that it does not have."""
    table = study.campaign
    if table is None:
        return
    try:
        drawn = simulate.drawn_bench(bench, table.first_seed)
        if table.on == "truth" and not callable(getattr(drawn, "linear_model", None)):
            raise InputError('the bench has no linear model that could stand for it; take on = "bench".')
    except UltraquietError as error:
        mistakes.add(("campaign",), f"campaign: {str(error).removeprefix('campaign: ')}")


def _records(study: Study, names: Sequence[str], mistakes: Mistakes) -> None:
    groups = grouped(names)
    known = dict.fromkeys([*names, *groups])
    asked: list[tuple[Place, str]] = [
        *((("identify", key), name) for key in ("records", "held_out") if (name := getattr(study.identify, key))),
        *((("paper", "records", k), name) for k, name in enumerate(study.paper.records if study.paper else ())),
        *((("plant", "records", k), name) for k, name in enumerate(study.plant.records)),
    ]
    for place, name in asked:
        if name not in known:
            fault = f"there are no records '{name}'; there are {', '.join(groups)}."
            mistakes.add(place, f"{place[0]}.{place[1]}: {fault}")
    for k, name in enumerate(study.paper.simulated if study.paper else ()):
        if name not in names:  # of a group each record is simulated by its own name
            fault = f"there is no record '{name}'; there are {', '.join(names)}."
            mistakes.add(("paper", "simulated", k), f"paper.simulated: {fault}")
    _held_out(study.identify, groups, mistakes)
    _plant_records(study.plant, groups, mistakes)


def _held_out(asked: IdentifyTable, groups: Mapping[str, Sequence[str]], mistakes: Mistakes) -> None:
    """Note records by which models are judged that were fitted to them."""
    fitted, judged = (recorded([name], groups) if name else [] for name in (asked.records, asked.held_out))
    both = [name for name in judged if name in fitted]
    if both:
        fault = (
            f"models are fitted to '{both[0]}', which cannot judge them as well; name other records or leave it away."
        )
        mistakes.add(("identify", "held_out"), f"identify.held_out: {fault}")


def _plant_records(settings: Plant, groups: Mapping[str, Sequence[str]], mistakes: Mistakes) -> None:
    """Note several records where the plant's method takes one, and a period where it takes no responses."""
    taken = recorded(settings.records, groups)
    if settings.period_samples is None and len(taken) > 1:
        mistakes.add(("plant", "records"), f"plant.records: {one_record_of(taken)}")
    elif settings.period_samples is not None and not hasattr(lookup("identify", settings.method), "identify_response"):
        fault = f"'{settings.method}' does not fit responses; leave 'period_samples' away."
        mistakes.add(("plant", "period_samples"), f"plant.period_samples: {fault}")
