"""The best flat attenuation: reached by a controller, exceeded by none, refused with a sentence where there is none."""

import numpy as np
import pytest
from limit_plants import RATE_HZ, band, modal, responses
from scipy.sparse.linalg import ArpackError

import ultraquiet as uq
from ultraquiet._base.errors import NumericalError
from ultraquiet.design import common_mode
from ultraquiet.limits import best_flat_attenuation, certificate, grid, search, waterbed_peak
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import feedback

LAG = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
# What a programme of few FIR-like functions had reached on the bench's heave (6 dB, 1000 V/V): no limit lies below.
REACHED_BEFORE = {(5.0, 100.0): 10.6, (5.0, 25.0): 13.0, (10.0, 100.0): 29.0, (20.0, 100.0): 40.0, (4.5, 5.5): 36.0}


@pytest.fixture(scope="module")
def heave():
    return common_mode(uq.bench.Hexapod(unit="ground").linear_model())


@pytest.mark.parametrize(
    "quiet_hz", [(10.0, 100.0), *(pytest.param(band, marks=pytest.mark.slow) for band in ((5.0, 100.0), (4.5, 5.5)))]
)
def test_heave_of_the_bench(heave, quiet_hz):
    # the narrow one is the deepest, and what is reached comes nearer with every function: 88 dB with 140
    basis = 80 if quiet_hz == (4.5, 5.5) else 60
    limit = best_flat_attenuation(heave, quiet_hz, 6.0, control_gain=1000.0, basis=basis)
    print(f"{quiet_hz}: {limit.attenuation_db:.2f} dB reached, {limit.bound_db:.2f} dB by none")
    assert limit.status.ok, limit.status
    assert limit.attenuation_db >= REACHED_BEFORE[quiet_hz]
    assert limit.attenuation_db <= limit.bound_db
    # the broad bands, where the peak binds, are known to a decibel; deep ones, far beyond any sensor, to four or ten
    apart = {(5.0, 100.0): 1.0, (5.0, 25.0): 1.5, (4.5, 5.5): 10.0}.get(quiet_hz, 4.0)
    assert limit.bound_db - limit.attenuation_db < apart


@pytest.mark.slow
def test_a_narrow_band_is_sought_by_its_width(heave, monkeypatch):
    found = best_flat_attenuation(heave, (100.0, 150.0), 6.0, control_gain=1000.0, basis=60, certify=False)
    monkeypatch.setattr(grid, "is_narrow", lambda band_hz: False)
    by_edges = best_flat_attenuation(heave, (100.0, 150.0), 6.0, control_gain=1000.0, basis=60, certify=False)
    print(f"{found.attenuation_db:.1f} dB, {by_edges.attenuation_db:.1f} by the frequencies of its edges")
    assert found.status.ok
    assert found.attenuation_db > by_edges.attenuation_db + 1.0


@pytest.mark.slow
def test_no_bound_of_few_functions_is_exceeded_by_more(heave):
    """A narrow deep band, whose discs a coarse circle does not tell: it gave 73.5 dB where 76.7 are reached."""
    few = best_flat_attenuation(heave, (4.5, 5.5), 6.0, control_gain=1000.0, basis=60)
    more = best_flat_attenuation(heave, (4.5, 5.5), 6.0, control_gain=1000.0, basis=80, certify=False)
    print(f"{few.status}\n{more.status}")
    assert not few.bound_db < more.attenuation_db


@pytest.mark.parametrize("growth", [1.0, 1.03], ids=["stable", "unstable"])
def test_its_controller_does_it(rng, growth):
    """Every demand on a grid that the programme never saw, from the controller alone."""
    plant, quiet = modal(rng, growth=growth), band(rng)
    limit = best_flat_attenuation(plant, quiet, 6.0, control_gain=50.0, basis=30, certify=False)
    print(f"{quiet}: {limit.status}")
    if not limit.status.ok:
        assert growth > 1, limit.status  # doing nothing keeps every demand of a stable plant
        return
    assert feedback(plant, limit.controller).is_stable()
    f = np.unique(np.concatenate([rng.uniform(0, RATE_HZ / 2, 3000), rng.uniform(*quiet, 1000)]))
    S, KS = responses(plant, limit.controller, f)
    inside = (f >= quiet[0]) & (f <= quiet[1])
    worst_db = -20 * np.log10(S[inside].max())
    print(f"reached {worst_db:.3f} dB of {limit.attenuation_db:.3f}, peak {20 * np.log10(S.max()):.3f}, {KS.max():.2f}")
    # cancelling to 60 dB leaves S = 1 - 0.999: what the loop's own arithmetic keeps of it is not asked for
    assert worst_db >= min(limit.attenuation_db, 60.0) - 0.1
    assert 20 * np.log10(S.max()) <= 6.1
    assert KS.max() <= 50 * 1.01


@pytest.mark.slow
def test_relaxing_a_demand_never_lowers_the_limit(rng):
    plant, quiet = modal(rng), band(rng)
    table = ([1.0, 250.0, 500.0], [0.1, 0.7, 3.0])  # below one in every band that is drawn
    strict = {"peak_db": 4.0, "control_gain": 10.0, "noise_gain": 2.0, "uncertainty": table, "delay_s": 0.002}
    milder = [
        {},
        {"peak_db": 6.0},
        {"control_gain": 30.0},
        {"noise_gain": None},
        {"uncertainty": None},
        {"delay_s": 0.0},
    ]
    found = [
        best_flat_attenuation(plant, quiet, **{**strict, **other}, basis=24, certify=False).attenuation_db
        for other in milder
    ]
    print(f"{quiet}: {np.round(found, 2)} dB for {milder}")
    # the delay changes the basis too: a different one of the same size may lose a little
    assert min(found[1:5]) >= found[0] - 0.05
    assert found[5] >= found[0] - 0.5
    inner = (quiet[0] * 1.1, quiet[1] / 1.05)
    narrow = best_flat_attenuation(plant, inner, **strict, basis=24, certify=False).attenuation_db
    assert narrow >= found[0] - 0.5


@pytest.mark.slow
def test_a_milder_peak_is_used_where_the_plant_is_uncertain():
    """A guess of the level lies above the level: what is true at the level says little of where the guess binds."""
    drawn_from = np.random.default_rng(20261130)
    plant, quiet = modal(drawn_from), band(drawn_from)
    asked = {"control_gain": 10.0, "uncertainty": ([1.0, 100.0, 500.0], [0.1, 0.5, 3.0]), "delay_s": 0.002}
    found = [
        best_flat_attenuation(plant, quiet, peak_db=peak_db, basis=24, certify=False, **asked) for peak_db in (4.0, 6.0)
    ]
    print([f"{limit.attenuation_db:.2f} dB, {limit.status}" for limit in found])
    assert found[1].attenuation_db > found[0].attenuation_db + 0.5


def test_what_is_left_out_of_a_grid_is_not_broken_in_turns():
    """Many laws reach this level, which a few points decide: each broke what the one before had kept."""
    drawn_from = np.random.default_rng(59)
    plant, quiet = modal(drawn_from), band(drawn_from)
    limit = best_flat_attenuation(
        plant, quiet, peak_db=4.0, control_gain=10.0, noise_gain=2.0, delay_s=0.002, basis=24, certify=False
    )
    print(limit.status)
    assert limit.status.ok
    assert limit.attenuation_db == pytest.approx(2.42, abs=0.05)


def test_never_beyond_the_waterbed(rng):
    plant, quiet = modal(rng), band(rng)
    limit = best_flat_attenuation(plant, quiet, 5.0, basis=30, certify=False)
    least = waterbed_peak(plant, quiet, limit.attenuation_db)
    print(f"{limit.attenuation_db:.2f} dB over {quiet} at {limit.peak_db:.3f} dB; closed form {least:.3f} dB")
    assert least <= limit.peak_db + 0.02


def test_pure_delay_meets_bodes_integral_exactly():
    """z^-1 without limit on control: |S| of any shape with mean ln|S| = 0, so the limit is the waterbed itself."""
    plant = StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    quiet, peak_db = (50.0, 150.0), 6.0
    exact = peak_db * (RATE_HZ / 2 - 100) / 100
    limit = best_flat_attenuation(plant, quiet, peak_db, basis=80)
    print(f"Bode {exact:.3f} dB; reached {limit.attenuation_db:.3f}, bound {limit.bound_db:.3f}")
    assert waterbed_peak(plant, quiet, exact) == pytest.approx(peak_db, rel=1e-6)
    assert limit.attenuation_db <= exact + 0.01
    assert exact - 0.3 < limit.attenuation_db
    assert exact - 0.05 < limit.bound_db < exact + 1.0


def test_continuous_plant_and_its_delay():
    lag = StateSpace([[-100.0]], [[100.0]], [[1.0]], [[0.0]])
    limit = best_flat_attenuation(lag, (5.0, 50.0), 6.0, control_gain=20.0, delay_s=0.002, basis=60)
    print(limit.status)
    assert limit.status.ok
    assert "optimum after" in limit.status.sentence
    assert "Solved" not in limit.status.sentence, "the solver's own word"
    assert limit.attenuation_db <= limit.bound_db < limit.attenuation_db + 1.5


def test_a_fraction_of_a_sample_costs_a_fraction():
    found = [
        best_flat_attenuation(LAG, (5.0, 50.0), control_gain=20.0, delay_s=k / RATE_HZ, basis=30, certify=False)
        for k in (1.0, 1.4, 2.0)
    ]
    levels = [limit.attenuation_db for limit in found]
    print(f"1, 1.4, 2 samples: {np.round(levels, 2)} dB")
    assert levels[0] > levels[1] > levels[2]


def second_order(damping, gain=1.0, speed=2 * np.pi * 50):
    """Return a continuous mode, for which cancelling takes a control that grows without end."""
    A = [[0.0, 1.0], [-(speed**2), -2 * damping * speed]]
    return StateSpace(A, [[0.0], [speed**2]], [[gain, 0.0]], [[0.0]])


SECOND_ORDER = {
    "well damped": second_order(0.3),
    "lightly damped": second_order(0.01),
    "in other units": second_order(0.3, 1e6),
    "double integrator": StateSpace([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]),
}


@pytest.mark.parametrize("name", SECOND_ORDER)
def test_a_second_order_plant_has_a_limit_without_a_limit_of_control(name):
    plant, quiet = SECOND_ORDER[name], (20.0, 100.0)
    limit = best_flat_attenuation(plant, quiet, basis=20, certify=False)
    print(limit.status)
    assert limit.status.ok
    assert limit.attenuation_db > 40
    f = np.geomspace(*quiet, 300)
    assert -20 * np.log10(responses(plant, limit.controller, f)[0].max()) > min(limit.attenuation_db, 60.0) - 0.1


@pytest.mark.parametrize("gain", [1e-14, 1e12])
def test_a_plant_in_any_unit_answers(gain):
    faint = StateSpace(LAG.A, LAG.B, gain * LAG.C, LAG.D, RATE_HZ)
    one, other = (best_flat_attenuation(G, (20.0, 100.0), basis=20, certify=False) for G in (LAG, faint))
    assert other.status.ok, other.status
    assert other.attenuation_db == pytest.approx(one.attenuation_db, abs=0.01)
    assert other.control_gain * gain == pytest.approx(one.control_gain, rel=0.01)


REFUSED = {
    "peak": (LAG, {"peak_db": -1.0}, "maximum principle"),
    "zero": (StateSpace([[0.9]], [[0.0]], [[1.0]], [[0.0]], rate_hz=RATE_HZ), {}, "does not answer"),
    "hidden": (
        StateSpace(np.diag([1.2, 0.5]), [[0.0], [0.1]], [[1.0, 1.0]], [[0.0]], rate_hz=RATE_HZ),
        {},
        "cannot be stabilised",
    ),
    "gain": (
        StateSpace([[1.2]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ),
        {"peak_db": 20.0, "control_gain": 0.1},
        "control gain",
    ),
    "amplification": (
        StateSpace([[1.2]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ),
        {"peak_db": 1.0, "control_gain": 100.0},
        "peak of S",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_said(case):
    plant, demands, word = REFUSED[case]
    limit = best_flat_attenuation(plant, (5.0, 50.0), basis=20, **demands)
    print(limit.status)
    assert limit.status.word == "refused"
    assert limit.controller is None
    assert word in limit.status.sentence


@pytest.mark.parametrize(
    "arguments",
    [
        {"band_hz": (5.0, 600.0)},
        {"band_hz": (50.0, 5.0)},
        {"band_hz": (5.0, 5.0)},
        {"peak_db": np.nan},
        {"control_gain": 0.0},
        {"noise_gain": -1.0},
        {"delay_s": -0.001},
        {"basis": 2},
        {"uncertainty": ([1.0, 2.0], [1.0])},
        {"uncertainty": StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])},
        {"plant": StateSpace(0.5 * np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), rate_hz=RATE_HZ)},
    ],
    ids=lambda a: next(iter(a)),
)
def test_nonsense_is_refused_by_name(arguments):
    with pytest.raises(uq.errors.InputError, match="best_flat_attenuation"):
        best_flat_attenuation(**{"plant": LAG, "band_hz": (5.0, 50.0), **arguments})


@pytest.mark.parametrize("grids", [0, 3])
def test_a_demand_exceeded_between_points_is_looked_at_and_said(heave, grids, monkeypatch):
    """One point in thirty of the usual grid: what a law does between them is found, and mended or told."""
    usual = grid.frequencies
    monkeypatch.setattr(grid, "frequencies", lambda *given: usual(*given)[::30])
    monkeypatch.setattr(search, "GRIDS", grids)
    limit = best_flat_attenuation(heave, (20.0, 100.0), 6.0, control_gain=1000.0, basis=20, certify=False)
    print(f"{grids} grids more: {limit.status}")
    assert limit.status.ok == (limit.violation < search.EXCEEDED)
    assert ("exceeded" in limit.status.sentence) == (limit.violation >= search.NEGLIGIBLE)
    if not grids:
        assert limit.status.word == "short"
        assert limit.violation > search.EXCEEDED


def test_a_circle_that_tells_nothing_is_followed_by_the_next(monkeypatch):
    """0: no level found out of reach; nan: too coarse to tell. Neither ends the search for a bound."""

    def bound_db(*levels):
        told = iter([*levels, *[levels[-1]] * len(search.CIRCLES)])
        monkeypatch.setattr(search.certificate, "lowest_level", lambda *_: next(told))
        return best_flat_attenuation(LAG, (20.0, 100.0), 6.0, control_gain=10.0, basis=30).bound_db

    found = bound_db(0.0, np.nan, 0.1), bound_db(np.nan, 0.0), bound_db(np.nan)
    print(f"bounds {found} dB")
    assert found[0] == pytest.approx(20.0)
    assert np.isposinf(found[1])
    assert np.isnan(found[2])


@pytest.mark.gate("quiet_hz0-30-1.0", "quiet_hz1-60-1000000.0", "quiet_hz2-60-1e-06")
@pytest.mark.parametrize("unit", [1.0, 1e6, 1e-6])
@pytest.mark.parametrize(("quiet_hz", "basis"), [((48.02, 49.98), 30), ((48.3, 49.7), 60), ((48.755, 49.245), 60)])
def test_a_band_about_one_tone_has_a_limit_or_none_and_no_end(unit, quiet_hz, basis):
    """Its few lines are met to rounding, where a level is nothing or less."""
    turn = 2 * np.pi * 49.0 / RATE_HZ
    A = 0.98 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    plant = StateSpace(A, [[0.05 * unit], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=RATE_HZ)
    limit = best_flat_attenuation(plant, quiet_hz, 6.0, control_gain=100.0 / unit, basis=basis)
    print(limit.status)
    assert limit.status.word in ("ok", "not certified")
    assert np.isnan(limit.bound_db) or limit.bound_db >= limit.attenuation_db


def merged(size=1.0):
    """Demands on equal angles of |1 + b Q| in a band and of |Q| over the axis, and weights of both."""
    angles = np.linspace(0, np.pi, 513)
    share = certificate.ramp(angles, 0.4, 1.2, 40)
    one = np.ones(angles.size)
    demands = [certificate.Merged(one + 0j, size * np.exp(-1j * angles), 2.0 ** (1 - share) * one, share)]
    demands.append(certificate.Merged(0j * one, size + 0j * one, 4.0 * one))
    return demands, np.full((2, angles.size), 0.5)


@pytest.mark.parametrize("reached", [0.0, -1e-24, np.nan])
def test_of_a_level_that_rounding_reaches_no_bound_is_told(reached):
    assert np.isnan(certificate.lowest_level(*merged(), reached))


@pytest.mark.parametrize(("size", "level"), [(1.0, -1e-24), (1.0, 1e-300), (1e200, 0.5), (1e-160, 0.5)])
def test_what_leaves_the_range_of_numbers_proves_nothing(size, level):
    norm, tail = certificate.hankel_measure(*merged(size), level)
    print(norm, tail)
    assert not (norm <= 1 and tail <= certificate.LARGEST_TAIL)
    if level > 0:
        assert not certificate.lowest_level(*merged(size), level) > 0


def test_a_norm_that_is_not_found_is_said(monkeypatch):
    def failing(*_, **__):
        raise ArpackError(-9999)

    monkeypatch.setattr("scipy.sparse.linalg.eigsh", failing)
    with pytest.raises(NumericalError, match="the norm that proves a bound was not found"):
        certificate.hankel_measure(*merged(), 0.5)


def test_a_limit_that_was_to_be_certified_and_was_not_says_so(monkeypatch):
    monkeypatch.setattr(search.certificate, "lowest_level", lambda *_: 0.0)
    limit = best_flat_attenuation(LAG, (20.0, 100.0), 6.0, control_gain=10.0, basis=30)
    assert limit.status.word == "not certified"
    assert "no bound was certified" in limit.status.sentence
    assert best_flat_attenuation(LAG, (20.0, 100.0), 6.0, control_gain=10.0, basis=30, certify=False).status.ok


@pytest.mark.parametrize("unit", [1.0, 1e-9])
@pytest.mark.parametrize("used", [0.6, 0.9, 0.98, 0.998])
def test_a_bound_by_the_control_alone_is_that_of_a_plain_gain(used, unit):
    # a plant without dynamics: S = 1 + g K S, and |K S| = used / g leaves 1 - used of it
    plant = StateSpace([[0.5]], [[1.0]], [[0.0]], [[0.2 * unit]], 100.0)
    found = best_flat_attenuation(plant, (1.0, 4.0), control_gain=used / (0.2 * unit), basis=20)
    truth = -20 * np.log10(1 - used)
    assert truth - 1e-3 <= found.bound_db <= truth + 0.1
