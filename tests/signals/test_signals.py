"""Test signals: limits, determinism and spectra hold for any settings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ultraquiet import signals
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import methods
from ultraquiet._base.tables import Method
from ultraquiet.signals.prbs import TAPS, sequence

RATE = 3500.0
amplitude = st.floats(0.1, signals.MAXIMUM_V)
frequency = st.floats(1.0, 1700.0)
lengths = st.integers(2048, 6000)
seeds = st.integers(0, 2**32)

any_signal = st.one_of(
    st.builds(signals.Chirp, frequency, frequency, amplitude, amplitude),
    st.builds(
        lambda lo, width, peak: signals.BandLimitedNoise(lo + width, peak, lo),
        st.floats(0.0, 1500.0),
        st.floats(5.0, 200.0),
        amplitude,
    ),
    st.builds(signals.Prbs, st.floats(1.0, 1550.0), amplitude),
    st.builds(signals.Tone, frequency, amplitude, st.floats(-360.0, 360.0)),
    st.builds(signals.Step, amplitude),
    st.builds(
        lambda lo, width, period, peak, odd, phases: signals.Multisine(lo, lo + width, period, peak, odd, phases),
        st.floats(0.0, 1500.0),
        st.floats(15.0, 200.0),
        st.integers(1024, 5000),
        amplitude,
        st.booleans(),
        st.sampled_from(["random", "schroeder"]),
    ),
)


@settings(max_examples=150, deadline=None)
@given(signal=any_signal, samples=lengths, seed=seeds)
def test_any_signal_is_finite_limited_and_repeatable(signal, samples, seed):
    u = signal.generate(samples, RATE, seed)
    assert u.shape == (samples,)
    assert u.dtype == np.float64
    assert np.isfinite(u).all()
    assert np.abs(u).max() <= signals.MAXIMUM_V
    assert np.array_equal(u, signal.generate(samples, RATE, seed))


@settings(max_examples=60, deadline=None)
@given(signal=any_signal, samples=lengths, seed=seeds)
def test_the_spectrum_holds_the_mean_square(signal, samples, seed):
    f_hz, psd = signal.spectrum(samples, RATE, seed)
    mean_square = np.mean(signal.generate(samples, RATE, seed) ** 2)
    assert psd.sum() * (f_hz[1] - f_hz[0]) == pytest.approx(mean_square, rel=1e-9)


@settings(max_examples=40, deadline=None)
@given(low=st.floats(0.0, 1000.0), width=st.floats(5.0, 500.0), seed=seeds)
def test_noise_stays_in_its_band_and_reaches_its_peak(low, width, seed):
    noise = signals.BandLimitedNoise(low + width, 20.0, low)
    f_hz, psd = noise.spectrum(4096, RATE, seed)
    outside = (f_hz < low) | (f_hz > low + width)
    # Clipping the peak's rounding error and the FFT leave a floor near 1e-30 of the power in the band.
    assert psd[outside].max(initial=0.0) < 1e-20 * psd.max()
    assert np.abs(noise.generate(4096, RATE, seed)).max() == pytest.approx(20.0, rel=1e-12)


def test_noise_differs_from_seed_to_seed_and_is_gaussian(seed):
    noise = signals.BandLimitedNoise(stop_hz=250)
    a, b = (noise.generate(65536, RATE, seed + i) for i in (0, 1))
    assert not np.array_equal(a, b)
    kurtosis = np.mean(a**4) / np.mean(a**2) ** 2
    print(f"kurtosis {kurtosis:.3f}")
    # About 9400 independent values: the standard deviation of their kurtosis is sqrt(24 / 9400) = 0.05.
    assert abs(kurtosis - 3.0) < 6 * np.sqrt(24 / 9400)


def test_the_paper_s_chirp():
    u = signals.Chirp(start_hz=5, stop_hz=100, start_v=25, stop_v=5).generate(4096, RATE)
    edges = np.flatnonzero((u[:-1] < 0) & (u[1:] >= 0))
    period = np.diff(edges) / RATE
    assert 1.0 / period[0] < 20.0
    assert 1.0 / period[-1] == pytest.approx(100.0, rel=0.03)
    assert np.abs(u[:600]).max() > 22.0
    assert np.abs(u[-200:]).max() < 6.0


def test_paper_s_signals_carry_power_where_section_3_3_says(seed):
    """Above 10 dB/Hz up to 200, 400 and 175 Hz, says the paper, of spectra it does not scale; here in V^2/Hz."""
    paper = (
        (signals.Chirp(5.0, 100.0, 25.0, 5.0), 95.0),
        (signals.BandLimitedNoise(250.0, 25.0), 250.0),
        (signals.Prbs(150.0, 25.0), 150.0),
    )
    for signal, stop_hz in paper:
        f_hz, psd = signal.spectrum(4096, RATE, seed)
        wide = np.convolve(psd, np.ones(25) / 25, mode="same")
        inside = (f_hz > 15.0) & (f_hz < stop_hz - 10.0)
        print(type(signal).__name__, f"{10 * np.log10(wide[inside].min()):.1f} dB V^2/Hz")
        assert wide[inside].min() > 10 ** (-20 / 10)


def test_prbs_has_two_levels_whole_bits_and_its_bandwidth(seed):
    prbs = signals.Prbs(stop_hz=150, level_v=12.5)
    hold = prbs.hold_samples(RATE)
    u = prbs.generate(2**20, RATE, seed)
    assert set(np.unique(u)) == {-12.5, 12.5}
    assert np.all(np.flatnonzero(np.diff(u)) % hold == hold - 1)
    segments = u.reshape(-1, 4096)
    psd = np.mean(np.abs(np.fft.rfft(segments)) ** 2, axis=0)
    f_hz = np.fft.rfftfreq(4096, 1 / RATE)
    low = psd[(f_hz > 3) & (f_hz < 20)].mean()
    at_edge = psd[np.abs(f_hz - 150) < 8].mean()
    print(f"power at 150 Hz {10 * np.log10(at_edge / low):.2f} dB")
    assert -4.5 < 10 * np.log10(at_edge / low) < -1.5


@pytest.mark.gate(*(str(stages) for stages in TAPS if stages < 18))
@pytest.mark.parametrize("stages", TAPS)
def test_registers_are_of_maximal_length(stages):
    n = 2**stages - 1
    bits = sequence(stages, n + stages, start=1).astype(np.int64)
    states = sum(bits[i : i + n] << i for i in range(stages))
    assert np.unique(states).size == n


def test_step_edges_of_fig_8():
    u = signals.Step(-7.0, 0.057, 0.687).generate(4096, RATE)
    rise, fall = np.flatnonzero(np.diff(u)) + 1
    assert (rise / RATE, fall / RATE) == pytest.approx((0.057, 0.687), abs=1 / RATE)
    assert u.min() == -7.0


@pytest.mark.parametrize("odd", [False, True])
def test_multisine_excites_its_lines_only(odd, seed):
    sine = signals.Multisine(5.0, 250.0, 2048, peak_v=10.0, odd=odd)
    u = sine.generate(3 * 2048, RATE, seed)
    assert np.array_equal(u[:2048], u[2048:4096])
    amplitude = np.abs(np.fft.rfft(u[:2048]))
    k = sine.harmonics(RATE)
    assert np.ptp(amplitude[k]) < 1e-9 * amplitude.max()
    assert np.delete(amplitude, k).max() < 1e-9 * amplitude.max()
    assert not odd or np.all(k % 2 == 1)
    assert np.array_equal(sine.lines_hz(RATE), k * RATE / 2048)


def test_schroeder_phases_lower_the_crest():
    crest = {}
    for phases in ("random", "schroeder"):
        u = signals.Multisine(5.0, 250.0, 4096, phases=phases).generate(4096, RATE, 1)
        crest[phases] = np.abs(u).max() / np.sqrt(np.mean(u**2))
    print(crest)
    assert crest["schroeder"] < 2.0 < crest["random"]


def test_on_actuator_fills_one_row():
    u = signals.on_actuator(np.ones(5), actuator=5, actuators=6)
    assert u.shape == (6, 5)
    assert u[5].sum() == u.sum() == 5.0


def test_signals_are_registered():
    assert set(methods("signals")) >= {"chirp", "noise", "prbs", "multisine", "tone", "step"}


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_levels_are_in_whatever_unit_the_actuator_has(unit):
    for small, large in (
        (signals.Tone(60.0), signals.Tone(60.0, amplitude_v=unit)),
        (signals.Step(level_v=1.0), signals.Step(level_v=unit)),
        (signals.BandLimitedNoise(peak_v=1.0), signals.BandLimitedNoise(peak_v=unit)),
        (signals.Prbs(level_v=1.0), signals.Prbs(level_v=unit)),
        (signals.Multisine(peak_v=1.0), signals.Multisine(peak_v=unit)),
        (signals.Chirp(start_v=1.0, stop_v=0.5), signals.Chirp(start_v=unit, stop_v=0.5 * unit)),
    ):
        assert np.allclose(large.generate(2048, RATE, 1), unit * small.generate(2048, RATE, 1), rtol=1e-12, atol=0.0)


BAD = [
    (lambda: signals.Chirp(start_v=float("inf")), "'start_v' must be finite"),
    (lambda: signals.Chirp(start_hz=0.0), "above zero"),
    (lambda: signals.Chirp(stop_hz=1750.0).generate(4096, RATE), "below half the sampling rate, 1750 Hz"),
    (lambda: signals.BandLimitedNoise(peak_v=float("inf")), "'peak_v' must be finite"),
    (lambda: signals.BandLimitedNoise(peak_v=0.0), "above zero"),
    (lambda: signals.BandLimitedNoise(stop_hz=10.0, start_hz=20.0), "start_hz < stop_hz"),
    (lambda: signals.BandLimitedNoise(stop_hz=5000.0).generate(4096, RATE), "below half the sampling rate"),
    (lambda: signals.BandLimitedNoise(stop_hz=0.5).generate(64, RATE), "take more samples"),
    (lambda: signals.Prbs(level_v=float("nan")), "finite"),
    (lambda: signals.Prbs(stop_hz=1600.0).generate(4096, RATE), "must not exceed 1550.15 Hz"),
    (lambda: signals.Tone(frequency_hz=-1.0), "above zero"),
    (lambda: signals.Tone(frequency_hz=2000.0).generate(4096, RATE), "below half the sampling rate"),
    (lambda: signals.Step(level_v=float("-inf")), "'level_v' must be finite"),
    (lambda: signals.Step(rise_s=1.0, fall_s=0.5), "must come after"),
    (lambda: signals.Multisine(5.0, 5.1, 64).generate(4096, RATE), "lengthen the period"),
    (lambda: signals.Multisine(phases="best"), "one of 'random', 'schroeder'"),
    (lambda: signals.Tone(10.0).generate(0, RATE), "at least 1"),
    (lambda: signals.Tone(10.0).generate(10.5, RATE), "whole number"),
    (lambda: signals.Tone(10.0).generate(10, 0.0), "above zero"),
    (lambda: signals.on_actuator([1.0], actuator=6, actuators=6), "between 0 and 5"),
]


@pytest.mark.parametrize(("make", "words"), BAD, ids=[words for _, words in BAD])
def test_bad_settings_are_refused_in_one_sentence(make, words):
    with pytest.raises(InputError) as caught:
        make()
    text = str(caught.value)
    assert words in text
    assert text.endswith(".")
    assert "\n" not in text


@pytest.mark.parametrize("kind", [signals.BandLimitedNoise, signals.Prbs, signals.Multisine])
@pytest.mark.parametrize("wrong", [-1, 0.5])
def test_a_seed_is_a_whole_number(kind, wrong):
    with pytest.raises(InputError, match="seed"):
        kind().generate(samples=4096, rate_hz=3500.0, seed=wrong)


@pytest.mark.parametrize("kind", methods("signals").values(), ids=lambda kind: kind.__name__)
def test_a_signal_that_names_nothing_fits_any_bench(kind, seed):
    """No band, level or length of one bench is a default: amplitude one, frequencies and times by the rate alone."""
    one = kind().generate(4096, 1.0, seed)
    for rate in (250.0, 48_000.0):
        gap = np.abs(kind().generate(4096, rate, seed) - one).max()
        print(f"{kind.__name__}: peak {np.abs(one).max():.3f}, at {rate:g} Hz off that at 1 Hz by {gap:.1e}")
        assert gap < 1e-9
    assert 0.9 < np.abs(one).max() <= 1.0


OLDER = [
    ("chirp", {"start_v": 3.0, "stop_v": 2.0}, {"start_level": 3.0, "stop_level": 2.0}),
    ("multisine", {"peak_v": 3.0}, {"peak": 3.0}),
    ("noise", {"peak_v": 3.0}, {"peak": 3.0}),
    ("prbs", {"level_v": 3.0}, {"level": 3.0}),
    ("step", {"level_v": 3.0}, {"level": 3.0}),
    ("tone", {"amplitude_v": 3.0}, {"amplitude": 3.0}),
]


@pytest.mark.parametrize(("name", "older", "newer"), OLDER)
def test_a_level_answers_to_its_older_name(name, older, newer):
    """As an argument, as an attribute and in a table; what is shown has the newer name, a refusal the one given."""
    kind = methods("signals")[name]
    signal = kind(**older)
    assert signal == kind(**newer) == Method(method=name, **older).make("signals")
    assert [getattr(signal, key) for key in older] == list(older.values())
    assert not any(key in repr(signal) for key in older)
    for key, value in older.items():
        with pytest.raises(InputError, match=f"'{key}' must be finite"):
            kind(**{key: np.nan})
        with pytest.raises(InputError, match=f"'{key}' should be a valid number"):
            Method(method=name, **{key: "loud"}).make("signals")
        with pytest.raises(InputError, match=f"'{key}' is an older name of"):
            kind(**newer, **{key: value})
        with pytest.raises(InputError, match=f"'{key}' is an older name of"):
            Method(method=name, **newer, **{key: value}).make("signals")


@pytest.mark.parametrize(("name", "older", "newer"), OLDER)
def test_a_level_that_nobody_named_is_one_or_what_it_is_told(name, older, newer):
    kind = methods("signals")[name]
    unnamed, told = kind().generate(512, RATE), kind().at(2.5)
    assert set(kind().unnamed_levels()) == set(newer)
    assert not told.unnamed_levels()
    assert np.array_equal(unnamed, kind(**dict.fromkeys(newer, 1.0)).generate(512, RATE))
    assert np.allclose(told.generate(512, RATE), 2.5 * unnamed, rtol=1e-12)
    named = kind(**newer)
    assert named.at(2.5) is named
