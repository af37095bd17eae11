"""What every registered method must do. A failure is an AssertionError that names the method and the promise."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet._base.registry import FAMILIES, lookup
from ultraquiet.bench import Block, Streaming
from ultraquiet.testing import problems
from ultraquiet.values import Record, StateSpace, Status

RATE_HZ = 3500.0
LARGEST_V = 25.0
# Largest relative change of a controller that loses only states of a share `problems.FAINT` of its size.
FAINT_ERROR = 1e-2
ROUNDING = 1e-6


def check(family: str, name: str, seed: int = 0, **settings: Any) -> None:
    """Check one registered method against what its family promises.

    Args:
        family: `signals`, `bench`, `identify`, `design` or `reduce`.
        name: under which it is registered.
        seed: of the problem it is tried on.
        settings: what the method cannot do without, a bench's program for instance.

    Raises:
        AssertionError: a promise is broken; the message says which.

    >>> check("signals", "chirp")
    """
    kind = lookup(family, name)
    _is_a_settings_object(kind, name, settings)
    assert callable(getattr(kind, FAMILIES[family], None)), f"{name}: the verb '{FAMILIES[family]}' is missing"
    _CHECKS[family](name, kind(**settings), seed)


def _is_a_settings_object(kind: type[Any], name: str, required: Mapping[str, Any]) -> None:
    assert is_dataclass(kind), f"{name}: must be a dataclass"
    assert (kind.__doc__ or "").strip(), f"{name}: must say what it does"
    settings = kind(**required)
    for field in fields(kind):
        try:
            setattr(settings, field.name, None)
        except FrozenInstanceError:
            continue
        raise AssertionError(f"{name}: must be frozen, '{field.name}' could be set")


def _signal(name: str, signal: Any, seed: int) -> None:
    first = signal.generate(samples=4096, rate_hz=RATE_HZ, seed=seed)
    again = signal.generate(samples=4096, rate_hz=RATE_HZ, seed=seed)
    assert first.shape == (4096,), f"{name}: must return (samples,)"
    assert np.array_equal(first, again), f"{name}: must repeat itself for one seed"
    assert np.all(np.isfinite(first)), f"{name}: must be finite"
    assert np.abs(first).max() <= LARGEST_V, f"{name}: must stay within {LARGEST_V} V"
    assert np.ptp(first) > 0, f"{name}: must move"
    _refuses(name, lambda: signal.generate(samples=0, rate_hz=RATE_HZ, seed=seed))


def _bench(name: str, bench: Any, seed: int) -> None:
    nu, ny = len(bench.actuators), len(bench.sensors)
    u = 0.1 * np.random.default_rng(seed).standard_normal((nu, 50))
    record = bench.run(u)
    assert isinstance(record, Record), f"{name}: run must return a Record"
    assert record.outputs.shape == (ny, 50), f"{name}: outputs must be (ny, n)"
    assert record.rate_hz == bench.rate_hz, f"{name}: the record must carry the bench's rate"
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), np.zeros((nu, ny)), bench.rate_hz)
    assert bench.run(u, disturbance=u, controller=law).samples == 50, f"{name}: must run with a controller"
    _refuses(name, lambda: bench.run(np.full((nu, 50), np.nan)))
    _refuses(name, lambda: bench.run(np.zeros((nu + 1, 50))))
    if isinstance(bench, Streaming):
        short, whole = (_readings(bench.stream(u, run_index=0, block_samples=m)) for m in (7, 50))
        assert np.array_equal(short, whole), f"{name}: must stream the same readings whatever the length of its blocks"
        stopped = _readings(bench.stream(u, block_samples=7, stop=lambda: True, ramp_samples=9))
        assert stopped.shape[1] == 9, f"{name}: must end a run that is stopped after 'ramp_samples'"


def _readings(blocks: Iterable[Block]) -> FloatArray:
    return np.concatenate([block.readings for block in blocks], axis=1)


def _identify(name: str, method: Any, seed: int) -> None:
    record, _ = problems.two_modes(seed)
    before = record.hash
    result = method.identify(record)
    assert isinstance(result.status, Status), f"{name}: must carry a status"
    assert record.hash == before, f"{name}: must not touch its input"
    assert np.shape(result.fit_percent) == (1,), f"{name}: fit_percent must be (ny,)"
    assert np.shape(result.loss) == (1,), f"{name}: loss must be (ny,)"
    system = result.model if isinstance(result.model, StateSpace) else result.model.state_space()
    # structures with A in common bind no pole of it: such a model may be unstable, but not called good
    assert system.is_stable() or not result.status.ok, f"{name}: must not call an unstable model of a stable plant ok"
    constant = Record(np.ones((1, record.samples)), record.outputs, record.rate_hz)
    _refuses(name, lambda: method.identify(constant))
    _refuses(name, lambda: method.identify(record.part(0, 8)))


def _with_ranges(plant: StateSpace) -> StateSpace:
    """Return the plant with commands that have ends: a law that adapts asks for them."""
    wires = [replace(c, low=-LARGEST_V, high=LARGEST_V) for c in plant.actuators]
    return replace(plant, actuators=tuple(wires))


def _design(name: str, method: Any, seed: int) -> None:
    plant = _with_ranges(problems.damped_plant(seed))
    result = method.design(plant)
    assert isinstance(result.status, Status), f"{name}: must carry a status"
    assert result.status.ok, f"{name}: must solve a damped square plant, said '{result.status}'"
    law = result.controller
    assert law.rate_hz == plant.rate_hz, f"{name}: the controller must carry the plant's rate"
    assert law.D.shape == (plant.D.shape[1], plant.D.shape[0]), f"{name}: the controller must fit the plant"
    radius = np.abs(problems.loop_poles(plant, law)).max()
    assert radius < 1, f"{name}: u = K y must stabilise, the loop has a pole of modulus {radius:.6f}"


def _reduce(name: str, method: Any, seed: int) -> None:
    plant = problems.damped_plant(seed)
    law = problems.observer_law(plant)
    padded = problems.with_faint_states(law)
    slim = type(method)(states=law.states).reduce(padded, plant)
    assert isinstance(slim.status, Status), f"{name}: must carry a status"
    assert slim.status.ok, f"{name}: must be able to drop states that hardly matter, said '{slim.status}'"
    assert slim.controller.states <= law.states, f"{name}: must keep the number of states asked for"
    moved = problems.distance(padded, slim.controller) / problems.distance(padded)
    assert moved < FAINT_ERROR, f"{name}: must drop what hardly matters, but changed the controller by {moved:.2g}"
    assert _settles(plant, slim.controller), f"{name}: must keep the loop stable when it drops what hardly matters"
    _owns_up(name, type(method)(states=law.states - 2).reduce(law, plant), law, plant)


def _owns_up(name: str, cut: Any, law: StateSpace, plant: StateSpace) -> None:
    """Check what is said of a cut that hurts: no method can promise that the loop survives it."""
    assert cut.controller.states <= law.states - 2, f"{name}: must keep the number of states asked for"
    bound = cut.bound
    if bound is None:
        assert not cut.status.ok or _settles(plant, cut.controller), f"{name}: must not call a lost loop ok"
    else:  # it judges the controller alone, and says how far off it may be
        error = problems.distance(law, cut.controller)
        assert error <= bound * (1 + ROUNDING), f"{name}: promised an error of {bound:.3g} at most, made {error:.3g}"


def _settles(plant: StateSpace, law: StateSpace) -> bool:
    return bool(np.abs(problems.loop_poles(plant, law)).max() < 1)


def _refuses(name: str, act: Callable[[], object]) -> None:
    refusal: UltraquietError | None = None
    try:
        act()
    except UltraquietError as error:
        refusal = error
    assert refusal is not None, f"{name}: must refuse bad input"
    assert isinstance(refusal, InputError), f"{name}: must refuse bad input as InputError, got {refusal!r}"
    assert str(refusal).strip(), f"{name}: must say what is wrong"


_CHECKS: Mapping[str, Callable[[str, Any, int], None]] = {
    "signals": _signal,
    "bench": _bench,
    "identify": _identify,
    "design": _design,
    "reduce": _reduce,
}
