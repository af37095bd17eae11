"""Loops on a bench whose sensitivity is known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_loops import drawn_plant, modal
from drawn_loops import wrapped as drawn_bench
from scipy.linalg import expm

import ultraquiet as uq
from ultraquiet._base.errors import InputError, RateError
from ultraquiet.bench.linear import LinearBench
from ultraquiet.simulate.open_loop import OpenLoop
from ultraquiet.simulate.sensitivity.measure import may_peak_below
from ultraquiet.simulate.sensitivity.pair import decides
from ultraquiet.simulate.sweeps.band import OPEN_LINES
from ultraquiet.testing.problems import RATE_HZ, damped_plant, loop_poles, observer_law


def wrapped(plant, noise_v=0.0, rng=None):
    """The plant as a bench: disturbance at its input, command one sample late, white sensor noise."""
    state = np.zeros(plant.states)

    def step(u, d):
        nonlocal state
        y = plant.C @ state + plant.D @ (u + d)
        state = plant.A @ state + plant.B @ (u + d)
        return y + (noise_v * rng.standard_normal(y.size) if noise_v else 0.0)

    def reset():
        nonlocal state
        state = np.zeros(plant.states)

    names = [uq.Channel(f"strut {i + 1}", "V", -25.0, 25.0) for i in range(plant.B.shape[1])]
    sensors = [uq.Channel(f"geophone {i + 1}", "V", -10.0, 10.0) for i in range(plant.C.shape[0])]
    return uq.bench.Wrapped(step, reset, plant.rate_hz, names, sensors)


@pytest.fixture
def loop(seed):
    """A plant scaled to the volts of a bench, a mild law, and the sensitivity they have with one sample of delay."""
    plant = damped_plant(seed)
    size = np.abs(plant.frequency_response(np.arange(1.0, 400.0))).max()
    plant = uq.StateSpace(plant.A, plant.B, plant.C / size, plant.D, plant.rate_hz)
    law = observer_law(plant)

    def truth(f_hz):
        z = np.exp(2j * np.pi * f_hz / RATE_HZ)
        GK = np.einsum("ijf,jkf->fik", plant.frequency_response(f_hz), law.frequency_response(f_hz) / z)
        return np.linalg.inv(np.eye(2) - GK).transpose(1, 2, 0)

    return plant, law, truth


def test_tone_reduction_is_that_of_the_sensitivity(loop):
    plant, law, truth = loop
    tones = (15.0, 40.0, 120.0)
    measured = uq.simulate.attenuation(wrapped(plant), law, tones, duration_s=4.0)
    G, S = plant.frequency_response(tones), truth(np.array(tones))
    for k in range(3):
        opened = G[:, :, k] @ np.ones(2)
        expected = -20 * np.log10(np.abs(S[:, :, k] @ opened) / np.abs(opened))
        assert measured.reduction_db[k] == pytest.approx(expected, abs=0.1)
        assert measured.paper_db[k] == pytest.approx(-20 * np.log10(np.abs(S[:, :, k] @ opened)), abs=0.1)
    print(f"reductions {measured.reduction_db.round(2).tolist()}")


def test_measured_sensitivity_is_the_true_one(loop, rng):
    plant, law, truth = loop
    measured = uq.simulate.measure_sensitivity(wrapped(plant, 1e-7, rng), law)
    expected = truth(measured.f_hz)
    band = measured.f_hz >= 10
    worst = -20 * np.log10(np.linalg.svd(expected.transpose(2, 0, 1), compute_uv=False)[:, 0])
    error = np.abs(measured.worst_direction_db() - worst)[band].max()
    print(f"worst direction: {error:.3f} dB from the truth above 10 Hz")
    assert error < 0.5
    assert measured.peak_amplification_db() == pytest.approx(-worst.min(), abs=0.5)


def delayed(plant):
    """The plant with the computing delay of the bench at its input."""
    n, nu = plant.B.shape
    A = np.block([[plant.A, plant.B], [np.zeros((nu, n + nu))]])
    return uq.StateSpace(
        A, np.vstack([np.zeros((n, nu)), np.eye(nu)]), np.hstack([plant.C, plant.D]), 0 * plant.D, plant.rate_hz
    )


def louder(law):
    return (uq.StateSpace(law.A, law.B, -(2.0**k) * law.C, law.D, law.rate_hz) for k in range(40))


@pytest.mark.slow
def test_a_calm_loop_and_a_wild_one_are_told_apart(loop, rng):
    plant, law, _ = loop
    bench = wrapped(plant, 1e-3, rng)
    assert uq.simulate.check_stability(bench, law).status.ok
    wild = next(w for w in louder(law) if np.abs(loop_poles(delayed(plant), w)).max() > 1.02)
    verdict = uq.simulate.check_stability(bench, wild)
    print(verdict.status)
    assert not verdict.status.ok


def test_refusals(loop):
    plant, law, _ = loop
    bench = wrapped(plant)
    with pytest.raises(InputError, match=r"between 0\.5 and 500 Hz"):
        uq.simulate.attenuation(bench, law, (0.1,), duration_s=4.0)
    for beyond in (500.0, 600.0):
        with pytest.raises(InputError, match="must lie below Nyquist's 500 Hz"):
            uq.simulate.attenuation(bench, law, (25.0, beyond))
    for wrong in ({"tones_hz": ()}, {"tones_hz": 5}, {"amplitude_v": 0.0}, {"amplitude_v": -1.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            uq.simulate.attenuation(bench, law, **{"tones_hz": (25.0,), **wrong})
    with pytest.raises(InputError, match="must be"):
        uq.simulate.disturb(bench, np.zeros((3, 10)))
    with pytest.raises(RateError, match="1000 Hz"):
        uq.simulate.attenuation(bench, uq.StateSpace(law.A, law.B, law.C, law.D, 500.0), (25.0,))


def test_a_law_that_runs_away_is_named_by_the_hexapod():
    wild = uq.StateSpace(1.5 * np.eye(6), np.eye(6), np.eye(6), np.zeros((6, 6)), 3500.0)
    with pytest.raises(InputError, match="no longer a finite number"):
        uq.bench.Hexapod().run(np.zeros((6, 7000)), controller=wild)


@pytest.mark.slow
@pytest.mark.parametrize(("ny", "nu"), [(4, 3), (3, 5)])
@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_sensitivity_of_rectangular_plants(ny, nu, unit, rng):
    """Tall: the largest |y closed| / |y open| that any disturbance has; wide: the whole matrix."""
    (A, B, C), K = drawn_plant(rng, ny, nu, 1.0)
    K *= 0.5
    noise = np.random.default_rng(rng.integers(2**32))
    bench = drawn_bench(A, B, unit * C, 1e-4 * unit, noise, (25.0, 10.0 * unit))
    law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), K / unit, bench.rate_hz)
    measured = uq.simulate.measure_sensitivity(bench, law)
    z = np.exp(2j * np.pi * measured.f_hz / bench.rate_hz)
    G = np.stack([C @ np.linalg.solve(x * np.eye(len(A)) - A, B) for x in z])
    closed = np.stack([np.linalg.solve(np.eye(ny) - g @ K / x, g) for x, g in zip(z, G, strict=True)])
    expected = -20 * np.log10(np.linalg.norm(closed @ np.linalg.pinv(G), 2, axis=(1, 2)))
    error = np.abs(measured.worst_direction_db() - expected)[~measured.hidden].max()
    print(f"{ny}x{nu}: {measured.f_hz.size} lines, {error:.3f} dB off; {measured.unresolved()} {measured.reach}")
    assert error < 0.5
    assert measured.hidden.mean() < 0.1
    assert measured.lines_missing == 0
    assert measured.reach.startswith("3 actuators reach 3 of 4" if nu < ny else "")
    assert bool(measured.reach) == (nu < ny)


@pytest.mark.slow
def test_lines_asked_for_are_all_there_and_hidden_ones_are_counted_at_their_bound(loop, rng):
    plant, law, truth = loop
    bench = wrapped(plant, 3e-2, rng)
    opened = uq.simulate.OpenLoop(bench)
    asked = np.arange(5.0, 400.0, 2.5)
    measured = uq.simulate.measure_sensitivity(bench, law, asked, opened=opened)
    assert measured.f_hz == pytest.approx(asked)
    worst = -20 * np.log10(np.linalg.svd(truth(asked).transpose(2, 0, 1), compute_uv=False)[:, 0])
    print(measured.unresolved(), np.abs(measured.worst_direction_db() - worst).max())
    assert measured.hidden.any()
    assert (measured.bound_db < measured.worst_direction_db()).all()
    assert (measured.bound_db[measured.hidden] < worst[measured.hidden]).mean() > 0.9
    assert measured.worst_in_band_db(5, 400) == measured.counted_db().min()
    with pytest.raises(InputError, match="'f_hz' must lie between"):
        uq.simulate.measure_sensitivity(bench, law, [0.001], opened=opened)
    with pytest.raises(InputError, match="of another bench"):
        uq.simulate.measure_sensitivity(wrapped(plant), law, opened=opened)


def test_what_a_law_is_measured_at_does_not_hang_on_the_laws_before(rng):
    opened = uq.simulate.OpenLoop(uq.bench.Hexapod(unit="ground", seed=1), seconds=2.0)
    d = np.zeros((6, 500))
    first = uq.simulate.disturb(opened.apart().bench, d)
    opened.apart().bench.run(rng.standard_normal((6, 500)))
    again = opened.apart()
    assert np.array_equal(uq.simulate.disturb(again.bench, d).outputs, first.outputs)
    for mine, own in zip(again.bands, opened.bands, strict=True):
        assert mine.bench is again.bench
        assert mine.response is own.response


@pytest.mark.slow
def test_a_peak_below_the_lowest_line_is_sought_there():
    """A law that takes half of the damping of a mode at 3 Hz: S peaks at 6 dB there, under what a run begins with."""
    w, damping, rate_hz = 2 * np.pi * 3.0, 0.2, 600.0
    A = expm(np.array([[0.0, 1.0], [-(w**2), -2 * damping * w]]) / rate_hz)
    plant = uq.StateSpace(A, [[0.0], [1.0 / rate_hz]], [[0.0, 1.0]], [[0.0]], rate_hz)
    law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[damping * w]], rate_hz)
    bench = uq.bench.LinearBench(plant)
    found = uq.simulate.measure_sensitivity(bench, law)
    f = np.arange(0.5, 20.0, 0.01)
    true_db = -20 * np.log10(np.abs(1 - plant.frequency_response(f)[0, 0] * damping * w))
    assert f[np.argmax(true_db)] < 3.6
    assert OpenLoop(bench).bands[0].sweep.low_hz == pytest.approx(4.0)
    assert found.f_hz[0] < 3.0
    assert found.peak_amplification_db() == pytest.approx(true_db.max(), abs=0.5)
    # a loop that is quiet there, or one asked for lines, is measured no further down than it was asked
    quiet = uq.StateSpace(law.A, law.B, law.C, -law.D, rate_hz)
    assert uq.simulate.measure_sensitivity(bench, quiet).f_hz[0] > 4.0


@pytest.mark.slow
def test_a_loop_that_amplifies_most_at_rest_is_measured_as_far_down_as_a_run_tells_lines_apart():
    """S = 2 at 0 Hz, by a law that takes half of the stiffness: no run is long enough for that, which is said."""
    rate_hz = 600.0
    pole = np.exp(-2 * np.pi * 20.0 / rate_hz)
    plant = uq.StateSpace([[pole]], [[1 - pole]], [[1.0]], [[0.0]], rate_hz)
    law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[0.5]], rate_hz)
    opened = OpenLoop(uq.bench.LinearBench(plant))
    found = uq.simulate.measure_sensitivity(opened.bench, law, opened=opened)
    run_s = opened.bands[0].sweep.samples / rate_hz
    assert 20 / run_s < found.f_hz[0] < 30 / run_s
    assert found.peak_amplification_db() == pytest.approx(20 * np.log10(2), abs=0.1)
    assert "the lowest" in found.unresolved()
    assert "perhaps more below" in found.unresolved()
    assert "below" not in found.unresolved(found.f_hz[0], 100.0)
    assert "below" not in uq.simulate.measure_sensitivity(opened.bench, law, [5.0, 50.0], opened=opened).unresolved()
    stiffer = uq.StateSpace(law.A, law.B, law.C, -law.D, rate_hz)
    assert "below" not in uq.simulate.measure_sensitivity(opened.bench, stiffer, opened=opened).unresolved()


@pytest.mark.gate("at rest")
@pytest.mark.parametrize(("modulus", "longer"), [(0.99, False), (0.9999, True)], ids=["at rest", "rings on"])
def test_a_bench_without_noise_is_listened_to_for_longer_only_where_it_rings(modulus, longer):
    """What rounding leaves at the end of a run is no ringing, though no hum covers it."""
    angle = 0.05
    A = modulus * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    bench = LinearBench(uq.StateSpace(A, [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], rate_hz=500.0))
    bands = OpenLoop(bench, seconds=16.0).bands
    print([(band.runs.length, band.runs.lines_open) for band in bands])
    assert (bands[0].runs.length > 1) is longer
    assert all(band.runs.lines_open <= OPEN_LINES for band in bands)


def test_noise_in_the_lowest_line_hides_no_peak_below_it(rng):
    """Lines a twentieth apart from what is true, as resolved ones are: one at the end may read a tenth too low."""
    f_hz = np.geomspace(4.2, 1600.0, 400)
    rises = 1 + (f_hz / 4.2) ** -2.0  # as many hertz below it may be anything
    falls = 1 / (1 + (f_hz / 8.0) ** -2.0) + 0.2
    for _ in range(50):
        noise = 1 + 0.05 * rng.standard_normal(f_hz.size)
        low = noise.copy()
        low[0] = 0.85
        assert may_peak_below(f_hz, (rises * low)[None, None])
        assert not may_peak_below(f_hz, (falls * noise)[None, None])


def test_passes_do_not_average_away_what_the_open_loop_s_noise_leaves_open(rng):
    """Without control S is one at every line, so what is read beside one is the error that the deviation bounds."""
    plant = uq.StateSpace([[0.9]], [[1.0]], [[0.1]], [[0.0]], rate_hz=500.0)
    nothing = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[0.0]], rate_hz=500.0)
    bench = wrapped(plant, 0.05, rng)
    opened = OpenLoop(bench, seconds=2.0)
    read = uq.simulate.measure_sensitivity(bench, nothing, np.arange(60.0, 230.0, 0.5), opened=opened)
    ratio = np.abs(np.abs(read.S.values[0, 0]) - 1) / read.deviation
    print(f"RMS of the error over its deviation {np.sqrt(np.mean(ratio**2)):.3f}, {read.hidden.mean():.2f} hidden")
    assert read.hidden.any()
    assert np.sqrt(np.mean(ratio**2)) < 0.9  # of a complex error that the deviation bounds, the real part: 0.71


@pytest.mark.parametrize(("hidden_size", "again"), [(1.0, False), (1.7, True)])
def test_a_hidden_line_that_would_be_read_as_the_peak_is_listened_to_again(hidden_size, again):
    """Its bound, two deviations above what was read, against the peak of 1.8 that is heard."""
    size = np.array([1.0, 1.8, hidden_size])
    assert decides(np.array([False, False, True]), size, np.array([0.01, 0.01, 0.15])) is again
    assert not decides(np.zeros(3, dtype=bool), size, np.full(3, 0.01))


@pytest.mark.slow
@pytest.mark.parametrize("limited", [False, True])
def test_hidden_lines_say_what_would_let_them_be_heard(limited, rng):
    """Without limits readings are kept to a share of their noise; with limits the bench is as loud as it can be."""
    A, B, C = modal(rng, 1, 1)
    noise = np.random.default_rng(rng.integers(2**32))
    # commands of one at most move a drawn plant by no more than 0.03 between its modes
    bench = drawn_bench(A, B, C, 1e-2 if limited else 1e-3, noise, (25.0, 10.0) if limited else (np.inf, np.inf))
    law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[0.0]], bench.rate_hz)
    measured = uq.simulate.measure_sensitivity(bench, law)
    measured = replace(measured, deviation=np.where(measured.f_hz > measured.f_hz[-2], 1.0, measured.deviation))
    print(measured.unresolved())
    hidden, last = int(measured.hidden.sum()), measured.f_hz[-1]
    assert f"hides {hidden} of {measured.f_hz.size} lines" in measured.unresolved()
    asks = "To hear more, give each channel its low and high: without them commands are kept to one unit and readings"
    assert (asks in measured.unresolved()) == (not limited)
    assert f"hides 1 of 1 line, {last:.4g} Hz; it is counted" in measured.unresolved(last, last)


def slow_loop(ny, nu, unit):
    """First-order plants side by side, and a law that quietens above 20 Hz more than below it."""
    n, rate_hz = min(ny, nu), 1000.0
    a, b = np.exp(-2 * np.pi * np.array([60.0, 20.0]) / rate_hz)
    actuators = [uq.Channel(f"u{k}", unit, -10.0, 10.0) for k in range(nu)]
    sensors = [uq.Channel(f"y{k}", f"{unit}/s", -100.0, 100.0) for k in range(ny)]
    plant = uq.StateSpace(
        a * np.eye(n), (1 - a) * np.eye(n, nu), np.eye(ny, n), np.zeros((ny, nu)), rate_hz, actuators, sensors
    )
    law = uq.StateSpace(b * np.eye(n), np.eye(n, ny), -5 * (b - 1) * np.eye(nu, n), -5.0 * np.eye(nu, ny), rate_hz)
    return plant, law


@pytest.mark.gate("4-3-N", "1-1-V")
@pytest.mark.parametrize(("ny", "nu", "unit"), [(1, 1, "V"), (4, 3, "N"), (3, 5, "mm")])
def test_a_band_is_measured_from_where_it_begins(ny, nu, unit):
    """Runs of 2 s begin at 32 Hz, where this law is quieter than below; those for 4 Hz are longer."""
    plant, law = slow_loop(ny, nu, unit)
    opened = OpenLoop(LinearBench(plant), seconds=2.0)
    begins_hz = opened.bands[0].sweep.low_hz
    low_hz = begins_hz / 8
    assert uq.simulate.measure_sensitivity(opened.bench, law, opened=opened).f_hz[0] > begins_hz
    found = uq.simulate.measure_sensitivity(opened.bench, law, opened=opened, down_to_hz=low_hz)
    assert found.f_hz[0] <= 1.01 * low_hz
    assert found.f_hz[0] > 0.6 * low_hz, "no further down than is asked"
    assert np.diff(np.log(np.unique(found.f_hz))).max() < 0.02
    truth, at_hz = uq.analyse.band_attenuation(plant, law, (low_hz, 40.0))
    assert at_hz == low_hz
    assert found.worst_in_band_db(low_hz, 40.0) == pytest.approx(truth, abs=0.1)


def test_where_a_band_was_not_measured_is_said():
    plant, law = slow_loop(1, 1, "V")
    bench = LinearBench(plant)
    found = uq.simulate.measure_sensitivity(bench, law, opened=OpenLoop(bench, seconds=2.0))
    low_hz = found.f_hz[0]
    assert found.unresolved(0.5, 200.0).endswith(f"Nothing was measured from 0.5 to {low_hz:.4g} Hz.")
    assert "Nothing" not in found.unresolved(1.02 * low_hz, 200.0)
    assert "Nothing" not in found.unresolved()


def test_a_bench_that_refuses_longer_runs_is_measured_as_far_down_as_it_goes():
    plant, law = slow_loop(1, 1, "V")
    model = LinearBench(plant)

    class Guarded(LinearBench):
        """Refuses runs beyond 3 s before anything moves, as hardware with an interlock on their duration does."""

        def run(self, actuation, *args, **kwargs):
            if np.shape(actuation)[1] > 3.0 * self.rate_hz:
                raise InputError("too long")
            return super().run(actuation, *args, **kwargs)

    bench = Guarded(plant)
    opened = OpenLoop(bench, seconds=2.0)
    found = uq.simulate.measure_sensitivity(bench, law, opened=opened, down_to_hz=1.0)
    unguarded = uq.simulate.measure_sensitivity(model, law, opened=OpenLoop(model, seconds=2.0), down_to_hz=1.0)
    assert unguarded.f_hz[0] <= 1.01
    assert 5.0 < found.f_hz[0] < 20.0


def test_a_band_begins_above_zero():
    plant, law = slow_loop(1, 1, "V")
    with pytest.raises(InputError, match="'down_to_hz'"):
        uq.simulate.measure_sensitivity(LinearBench(plant), law, down_to_hz=0.0)
