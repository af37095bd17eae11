"""Bands, criteria and conversions against the standards' numbers and closed forms."""

import numpy as np
import pytest
from scipy.stats import chi2

from ultraquiet._base.errors import InputError
from ultraquiet.spectra import (
    CRITERIA,
    band_levels,
    classify,
    convert_response,
    convert_spectrum,
    criterion,
    filtered_levels,
    frf,
    octave_bands,
    psd,
)
from ultraquiet.values import Channel, FrequencyResponse, Record

# IEC 61260-1:2014, table E.1: nominal and exact centres, and edges of one-third octaves, in Hz.
TABLE = [
    (25, 25.119, 22.387, 28.184),
    (31.5, 31.623, 28.184, 35.481),
    (40, 39.811, 35.481, 44.668),
    (50, 50.119, 44.668, 56.234),
    (63, 63.096, 56.234, 70.795),
    (80, 79.433, 70.795, 89.125),
    (100, 100.00, 89.125, 112.20),
    (125, 125.89, 112.20, 141.25),
    (160, 158.49, 141.25, 177.83),
    (200, 199.53, 177.83, 223.87),
    (250, 251.19, 223.87, 281.84),
    (315, 316.23, 281.84, 354.81),
    (400, 398.11, 354.81, 446.68),
    (500, 501.19, 446.68, 562.34),
    (630, 630.96, 562.34, 707.95),
    (800, 794.33, 707.95, 891.25),
    (1000, 1000.0, 891.25, 1122.0),
]


def test_one_third_octaves_are_those_of_the_standard():
    bands = octave_bands(25, 1000)
    ours = np.column_stack([bands.nominal_hz, bands.centre_hz, bands.low_hz, bands.high_hz])
    off = np.abs(ours / np.array(TABLE) - 1).max()
    print(f"largest deviation from the table {off:.1e}")
    assert off < 3e-5  # five digits are printed
    assert bands.high_hz[:-1] == pytest.approx(bands.low_hz[1:], rel=1e-12)


def test_octaves_and_halves():
    assert octave_bands(31.5, 8000, 1).nominal_hz.tolist() == [31.5, 63, 125, 250, 500, 1000, 2000, 4000, 8000]
    halves = octave_bands(500, 2000, 2).centre_hz
    assert halves == pytest.approx(1000 * 10 ** (0.3 * np.array([-0.75, -0.25, 0.25, 0.75])))


@pytest.mark.draws(false_alarm=2e-5)  # chi-squared, two estimators
def test_a_known_density_gives_the_analytic_levels(rng):
    rate, n = 1000.0, 2**17
    spectrum = psd(3.0 * rng.standard_normal(n), rate, 4096)
    found = band_levels(spectrum, start_hz=4, stop_hz=315)
    filtered = filtered_levels(3.0 * rng.standard_normal(n), rate, start_hz=4, stop_hz=315)
    expected = 3.0 * np.sqrt((found.bands.high_hz - found.bands.low_hz) / (rate / 2))
    for kind in (found, filtered):
        score = (kind.rms[0] / expected - 1) / kind.error
        print(
            f"{kind.estimator}: root mean square of deviation over its standard error {np.sqrt(np.mean(score**2)):.2f}"
        )
        # Twenty independent bands.
        assert np.sum(score**2) < chi2.ppf(1 - 1e-5, score.size)
        assert np.abs(kind.rms[0] / expected - 1)[-5:].max() < 0.04


def test_the_stated_error_of_a_level_is_its_scatter(rng):
    rms, n, draws = [], 2**13, 150
    for _ in range(draws):
        found = band_levels(psd(rng.standard_normal(n), 1000.0, 512), start_hz=50, stop_hz=400)
        rms.append(found.rms[0])
    ratio = np.std(rms, axis=0) / np.mean(rms, axis=0) / found.error
    print(f"scatter over stated error by band: {ratio.round(2)}")
    assert 0.8 < np.mean(ratio) < 1.2


def test_integral_and_filters_agree_on_a_sloped_spectrum(rng):
    x = np.cumsum(rng.standard_normal(2**17)) * 0.01
    x -= x.mean()
    both = [band_levels(psd(x, 1000.0, 8192), start_hz=8, stop_hz=200), filtered_levels(x, 1000.0, 3, 8, 200)]
    off = np.abs(20 * np.log10(both[0].rms / both[1].rms)).max()
    print(f"spectrum and filters differ by {off:.2f} dB at most")
    assert off < 1.0


def test_criterion_curves():
    values = {c.name: 1e6 * c.limit_m_s([8.0, 10.0, 79.433]) for c in CRITERIA}
    for name, level in (("VC-A", 50), ("VC-B", 25), ("VC-C", 12.5), ("VC-D", 6.25), ("VC-E", 3.12), ("VC-F", 1.56),
                        ("VC-G", 0.78), ("Workshop (ISO)", 800), ("Office (ISO)", 400), ("Residential day (ISO)", 200),
                        ("Operating theatre (ISO)", 100)):  # fmt: skip
        assert values[name] == pytest.approx(level)
    for name, micro_g in (("VC-A", 260), ("VC-B", 130)):
        acceleration = criterion(name).limit_m_s([4.0, 5.0, 6.3]) * 2 * np.pi * np.array([4.0, 5.0, 6.3]) / 9.80665
        print(f"{name} below 8 Hz: {1e6 * acceleration} µg, {micro_g} by the recommended practice")
        assert 1e6 * acceleration == pytest.approx(micro_g, rel=0.03)
    assert np.isnan(criterion("VC-B").limit_m_s([3.15, 100.0])).all()
    assert 1e6 * criterion("vc-e").limit_m_s([1.0]) == pytest.approx(3.12)


def floor(rng, rms_um_s, unit="m/s", rate=250.0, n=2**15):
    """A floor whose one-third octave at 80 Hz, the widest, holds the given velocity."""
    width = octave_bands(80, 80)
    density = rms_um_s / np.sqrt(float(width.high_hz[0] - width.low_hz[0]))
    scale = {"m/s": 1e-6, "µm/s": 1.0}[unit]
    y = density * np.sqrt(rate / 2) * scale * rng.standard_normal((1, n))
    return Record(np.zeros(n), y, rate, sensors=[Channel("floor", unit)])


def test_a_floor_is_classified_with_its_margin(rng):
    for unit in ("m/s", "µm/s"):
        levels = band_levels(psd(floor(rng, 5.0, unit), segment_samples=2048), start_hz=1, stop_hz=80)
        found = classify(levels)
        print(found.sentences[0], found.estimator)
        assert found.met[0].name == "VC-D"
        d = [c.name for c in found.judged].index("VC-D")
        assert found.margin_db[0, d, -1] == pytest.approx(20 * np.log10(6.25 / 5.0), abs=1.0)
    short = classify(band_levels(psd(floor(rng, 5.0), segment_samples=512), start_hz=4, stop_hz=80))
    assert [c.name for c in short.judged][-1] == "VC-B"
    assert short.met[0].name == "VC-B"
    loud = classify(band_levels(psd(floor(rng, 5000.0), segment_samples=2048), start_hz=1, stop_hz=80))
    assert loud.met == (None,)
    assert "meets none" in loud.sentences[0]
    assert "15." in loud.sentences[0] or "16." in loud.sentences[0] or "17." in loud.sentences[0]


def test_conversions_agree_with_a_tone(rng):
    t = np.arange(20000) / 1000.0
    amplitude, f = rng.uniform(0.1, 10), 50.0
    a = Record(np.zeros(t.size), amplitude * np.sin(2 * np.pi * f * t), 1000.0, sensors=[Channel("a", "g")])
    v = convert_spectrum(psd(a, segment_samples=2000), "acceleration", "velocity")
    x = convert_spectrum(v, "velocity", "displacement")
    assert (v.channels[0].unit, x.channels[0].unit) == ("m/s", "m")
    assert v.rms(45, 55)[0] == pytest.approx(9.80665 * amplitude / (2 * np.pi * f) / np.sqrt(2), rel=1e-4)
    back = convert_spectrum(x, "displacement", "acceleration")
    assert back.values == pytest.approx(psd(a, segment_samples=2000).values[:, 1:] * 9.80665**2, rel=1e-9)
    accelerance = FrequencyResponse([0.0, 1.0, 2.0], [[[1.0, 1.0, 1.0]]], variance=[[[1.0, 1.0, 1.0]]])
    mobility = convert_response(accelerance, "acceleration", "velocity")
    assert mobility.f_hz.tolist() == [1.0, 2.0]
    assert mobility.values[0, 0] == pytest.approx(1 / (2j * np.pi * mobility.f_hz))
    assert mobility.variance[0, 0] == pytest.approx(1 / (2 * np.pi * mobility.f_hz) ** 2)


def test_confidence_of_a_density_in_the_stated_share_of_draws(rng):
    """Chi-square intervals at 90 % hold the true density of white noise in 90 of 100 cases, overlapped or not."""
    for window, overlap in (("hann", 0.5), ("hann", 0.75), ("boxcar", 0.0)):
        inside, ends = [], []
        for _ in range(120):
            found = psd(rng.standard_normal(256 * 8), 1000.0, 256, overlap, window, "none")
            low, high = found.interval(0.9)
            held = ((low < 2e-3) & (high > 2e-3))[0]
            inside.append(held[4:-4:4])
            ends.append((low[0, 0] < 1e-3) & (high[0, 0] > 1e-3))
        share = np.mean(inside)
        print(f"{window}, overlap {overlap}: {100 * share:.1f} % of 90 %; at 0 Hz {100 * np.mean(ends):.0f} %")
        assert 0.88 < share < 0.925
        assert 0.75 < np.mean(ends) < 0.99


def test_parseval_and_the_power_of_a_sine(rng):
    x = rng.standard_normal((2, 4096))
    found = psd(x, 1000.0, 4096, 0.0, "boxcar", "none")
    assert found.cumulative_rms[:, -1] ** 2 == pytest.approx(np.mean(x**2, axis=1), rel=1e-12)
    assert (np.diff(found.cumulative_rms) >= 0).all()
    amplitude, f = rng.uniform(1, 10), rng.uniform(50, 400)
    sine = amplitude * np.sin(2 * np.pi * f * np.arange(40000) / 1000.0)
    for window in ("hann", "hamming", "flattop", "blackman"):
        power = psd(sine, 1000.0, 2000, window=window).rms() ** 2
        print(f"{window}: {power[0] / (amplitude**2 / 2):.5f} of A^2/2")
        assert power[0] == pytest.approx(amplitude**2 / 2, rel=2e-3)
    assert psd(sine, 1000.0, 1000).averaging.enbw_hz == pytest.approx(1.5)


def test_every_result_names_its_averaging(rng):
    record = Record(rng.standard_normal((1, 8000)), rng.standard_normal((1, 8000)), 1000.0)
    power = psd(record, segment_samples=1000)
    for text in (power.estimator, frf(record, 1000).estimator, band_levels(power).estimator):
        assert "15 segments of 1000 samples, window hann, overlap 0.5, detrend constant, resolution 1.5 Hz" in text


def bad_cases():
    rng = np.random.default_rng(0)
    x = psd(rng.standard_normal(8000), 1000.0, 1000)
    speed = Record(np.zeros(8000), rng.standard_normal(8000), 1000.0, sensors=[Channel("floor", "m/s")])
    return [
        (lambda: band_levels(x, start_hz=1.0), "take segments of 6501 samples"),
        (lambda: band_levels(x, stop_hz=500.0), "beyond half the rate"),
        (lambda: octave_bands(10.0, 1.0), "no centre of a 1/3 octave"),
        (lambda: filtered_levels(np.ones(100), 1000.0), "too few for the band at 1 Hz"),
        (lambda: filtered_levels(np.ones(10000)), "rate_hz"),
        (lambda: filtered_levels(np.ones(10000), 100.0), "reaches half the rate"),
        (lambda: classify(band_levels(x, start_hz=10, stop_hz=80)), "is in unit, the criteria need a velocity"),
        (lambda: classify(band_levels(psd(speed, segment_samples=1000), start_hz=10)), "cover no criterion"),
        (lambda: classify(band_levels(x, fraction=1)), "one-third octaves, got 1/1"),
        (lambda: criterion("VC-Z"), "there is no 'VC-Z'"),
        (lambda: convert_spectrum(x, "speed", "velocity"), "must be one of 'displacement'"),
        (lambda: convert_spectrum(psd(speed), "acceleration", "velocity"), "is in m/s, which is no acceleration"),
    ]


@pytest.mark.parametrize("case", bad_cases(), ids=lambda c: c[1])
def test_bad_input_is_a_sentence(case):
    call, words = case
    with pytest.raises(InputError) as caught:
        call()
    assert words in str(caught.value)


@pytest.mark.parametrize("offset", [1.0, 1e3, -1e6])
def test_an_offset_of_a_channel_is_no_vibration_of_any_band(rng, offset):
    x = rng.standard_normal((3, 20000)) * [[1.0], [1e-3], [1e3]]
    level = filtered_levels(x, rate_hz=1000.0, start_hz=4, stop_hz=80).rms
    found = filtered_levels(x + offset * np.array([[1.0], [1e-3], [1e3]]), rate_hz=1000.0, start_hz=4, stop_hz=80).rms
    assert np.allclose(found, level, rtol=1e-6, atol=0.0)
    still = filtered_levels(np.full(20000, offset / 3), rate_hz=1000.0, start_hz=4, stop_hz=80).rms
    assert still.max() < 1e-12 * abs(offset)
