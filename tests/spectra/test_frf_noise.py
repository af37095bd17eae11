"""Estimators of the frequency response: bias, coherence and variance against theory over many draws."""

from itertools import pairwise

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.spectra import coherence, cross_spectra, frf, magnitude_error
from ultraquiet.values import FrequencyResponse, Record

RATE = 1000.0
INNER = slice(3, -3)


def noisy(rng, gains, n, input_noise=0.0, output_noise=0.0):
    """White inputs through constant gains, noise of the given rms on either side."""
    u = rng.standard_normal((gains.shape[1], n))
    y = gains @ u + output_noise * rng.standard_normal((gains.shape[0], n))
    return Record(u + input_noise * rng.standard_normal(u.shape), y, RATE)


def test_h1_h2_hv_with_noise_on_either_side(rng):
    """With input noise a and output noise b (shares of power): H1 = 1/(1+a), H2 = 1+b, Hv = sqrt(H1 H2)."""
    for a, b in ((0.25, 0.0), (0.0, 0.25), (0.2, 0.4)):
        record = noisy(rng, np.array([[2.0]]), 2**18, np.sqrt(a), 2.0 * np.sqrt(b))
        found = {e: np.abs(frf(record, 256, estimator=e).values[0, 0, INNER]).mean() / 2 for e in ("H1", "H2", "Hv")}
        expected = {"H1": 1 / (1 + a), "H2": 1 + b, "Hv": np.sqrt((1 + b) / (1 + a))}
        print(f"input noise {a}, output noise {b}: {found}, theory {expected}")
        for name, value in expected.items():
            assert found[name] == pytest.approx(value, rel=0.01)
        assert found["H1"] <= found["Hv"] <= found["H2"]


def test_h2_of_two_by_two_is_free_of_input_noise_and_h1_is_not(rng):
    G = np.array([[1.0, 0.5], [-0.3, 2.0]])
    record = noisy(rng, G, 2**18, input_noise=0.5)
    h1, h2 = (frf(record, 256, estimator=e).values[:, :, INNER].mean(axis=2).real for e in ("H1", "H2"))
    print(f"H1 {h1.round(3).tolist()}, H2 {h2.round(3).tolist()}")
    assert h1 == pytest.approx(G / 1.25, abs=0.02)
    assert h2 == pytest.approx(G, abs=0.02)


def test_hv_told_the_noise_is_unbiased_with_several_inputs(rng):
    G = np.array([[1.0, 0.5], [-0.3, 2.0], [0.4, 0.4]])
    a, b = 0.3, 0.6
    record = noisy(rng, G, 2**18, a, b)
    noise = [a**2] * 2 + [b**2] * 3
    hv = frf(record, 256, estimator="Hv", noise=noise).values[:, :, INNER].mean(axis=2).real
    h1 = frf(record, 256).values[:, :, INNER].mean(axis=2).real
    print(f"Hv off by {np.abs(hv - G).max():.4f}, H1 by {np.abs(h1 - G).max():.4f}")
    assert np.abs(hv - G).max() < 0.02
    assert np.abs(h1 - G / (1 + a**2)).max() < 0.02


def test_hv_of_one_input_is_the_geometric_mean(rng):
    record = noisy(rng, np.array([[3.0], [0.2]]), 2**14, 0.5, 0.5)
    one, two, v = (frf(record, 512, estimator=e).values for e in ("H1", "H2", "Hv"))
    assert np.abs(v) == pytest.approx(np.sqrt(np.abs(one) * np.abs(two)), rel=1e-9)
    assert np.angle(v / one) == pytest.approx(0, abs=1e-9)


def test_scipy_agrees(rng):
    signal = pytest.importorskip("scipy.signal")
    x = rng.standard_normal((3, 5001)) + 0.3
    record = Record(x[:1], x[1:] + np.roll(x[:1], 3, axis=1), RATE)
    for window, overlap, detrend in (("hann", 0.5, "constant"), ("hamming", 0.3, "linear"), ("boxcar", 0.0, "none")):
        cross = cross_spectra(record, 500, overlap, window, detrend)
        how = {"fs": RATE, "window": window, "nperseg": 500, "noverlap": int(500 * overlap)}
        how["detrend"] = False if detrend == "none" else detrend
        z = np.concatenate([record.inputs, record.outputs])
        peer = signal.csd(z[np.newaxis], z[:, np.newaxis], **how)[1]
        assert cross.values == pytest.approx(peer, rel=1e-9, abs=1e-15)
        peer = signal.coherence(z[:1], z[1:], **how)[1]
        mine = coherence(cross)
        assert mine.ordinary[:, 0] == pytest.approx(peer[:, np.isin(cross.f_hz, mine.f_hz)], abs=1e-9)


def test_coherences_of_two_inputs_match_theory(rng):
    """y = u1 + 2 u2 + 1 n: ordinary 1/6 and 4/6, partial 1/2 and 4/5, multiple 5/6."""
    u, n = rng.standard_normal((2, 2**18)), rng.standard_normal(2**18)
    found = coherence(Record(u, u[0] + 2 * u[1] + n, RATE), 256)
    means = [x[..., INNER].mean(axis=-1).ravel() for x in (found.ordinary, found.partial, found.multiple)]
    print(f"ordinary {means[0]}, partial {means[1]}, multiple {means[2]}; {found.estimator}")
    assert means[0] == pytest.approx([1 / 6, 4 / 6], abs=0.01)
    assert means[1] == pytest.approx([1 / 2, 4 / 5], abs=0.01)
    assert means[2] == pytest.approx([5 / 6], abs=0.01)
    clean = coherence(Record(u, u[0] + 2 * u[1], RATE), 256)
    assert clean.multiple == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(("estimator", "inputs", "sides"), [("H1", 1, (0, 1)), ("H1", 3, (0, 1)), ("H2", 1, (0.7, 0)),
                                                          ("H2", 3, (0.5, 0)), ("Hv", 1, (0.6, 0.6))])  # fmt: skip
def test_the_variance_covers_in_95_of_100_cases(rng, estimator, inputs, sides):
    """Magnitude bands and discs from the variance, over many draws and lines: 93 to 97 of 100 must hold the truth."""
    from scipy.stats import f

    G = np.array([[2.0, -1.0, 0.5], [0.3, 1.0, -2.0], [1.0, 1.0, 1.0]])[:inputs, :inputs]
    truth = G * np.sqrt((1 + sides[1] ** 2 / G**2) / (1 + sides[0] ** 2)) if estimator == "Hv" else G
    inside, disc = [], []
    for _ in range(60):
        record = noisy(rng, G, 20 * 256, sides[0], sides[1])
        cross = cross_spectra(record, 256)
        g = frf(cross, estimator=estimator)
        degrees = cross.averaging.independent - inputs
        half = magnitude_error(g, degrees)
        # Lines apart by the window's main lobe, so that draws are independent.
        error = (g.values - truth[:, :, np.newaxis])[:, :, 4:-4:4]
        inside.append(np.abs(np.abs(g.values) - np.abs(truth)[:, :, np.newaxis])[:, :, 4:-4:4] < half[:, :, 4:-4:4])
        disc.append(np.abs(error) ** 2 < g.variance[:, :, 4:-4:4] * f.ppf(0.95, 2, 2 * degrees))
    radial, whole = np.mean(inside), np.mean(disc)
    print(f"{estimator}, {inputs} inputs: magnitude bands cover {100 * radial:.1f} %, discs {100 * whole:.1f} %")
    # Hv's level scatters less than its phase; its one variance serves both and is wide for the level.
    assert 0.93 < radial < (0.99 if estimator == "Hv" else 0.97)
    assert 0.93 < whole < 0.97


def test_records_that_excite_the_same_input_are_averaged(rng):
    records = [noisy(rng, np.array([[2.0]]), 2**13, output_noise=1.0) for _ in range(16)]
    one, all_ = frf(records[0], 256), frf(records, 256)
    gain = np.median(one.variance) / np.median(all_.variance)
    print(f"16 records lower the variance {gain:.1f} times; {all_.estimator}")
    assert 10 < gain < 25
    assert np.abs(all_.values - 2).mean() < np.abs(one.values - 2).mean()
    assert all_.estimator.startswith("H1, 1008 segments of 256 samples, window hann, overlap 0.5")


def test_inputs_that_move_together_in_part_are_solved_together(rng):
    G = np.array([[1.0, 2.0, 3.0]])
    records = []
    for moving in ((0, 1), (1, 2), (2,)):
        u = np.zeros((3, 2**14))
        u[list(moving)] = rng.standard_normal((len(moving), 2**14))
        records.append(Record(u, G @ u, RATE))
    found = frf(records, 512)
    assert found.values == pytest.approx(np.broadcast_to(G[:, :, np.newaxis], found.values.shape), abs=1e-9)


def test_blocks_of_a_recording_give_the_same_response(rng):
    record = noisy(rng, np.array([[2.0, 1.0], [0.5, -1.0]]), 20001, output_noise=0.3)
    cuts = [0, *np.sort(rng.integers(1, 20000, 15)).tolist(), 20001]
    pieces = (record.part(a, b) for a, b in pairwise(cuts) if b > a)
    streamed = frf(cross_spectra(pieces, 512))
    at_once = frf(record, 512)
    assert streamed.values == pytest.approx(at_once.values, abs=1e-12)
    assert streamed.estimator == at_once.estimator
    assert isinstance(streamed, FrequencyResponse)


@pytest.mark.parametrize("level", [0.0, 0.25, 0.1, 1e6 / 3, -1e-9 / 7])
@pytest.mark.parametrize("detrend", ["constant", "linear", "none"])
def test_an_input_that_stands_still_is_none_wherever_it_stands(rng, level, detrend):
    u = rng.standard_normal((2, 4096))
    y = np.array([[2.0, 1.0], [1.0, -1.0], [0.3, 1.0]]) @ u + 0.1 * rng.standard_normal((3, 4096))
    still = Record([u[0], np.full(4096, level), u[1]], y, RATE)
    bare = still.pick([0, 2])
    for wanted, found in (
        (coherence(bare, detrend=detrend), coherence(still, detrend=detrend)),
        (frf(bare, detrend=detrend), frf(still, detrend=detrend)),
        (frf(bare, detrend=detrend), frf(cross_spectra(still, detrend=detrend))),
    ):
        assert found.f_hz.tolist() == wanted.f_hz.tolist()
        assert [c.name for c in found.actuators] == ["input 1", "input 3"]
    assert frf(still, detrend=detrend).values == pytest.approx(frf(bare, detrend=detrend).values, rel=1e-12)


def test_no_output_is_dead_for_its_unit_and_none_alive_by_rounding(rng):
    u = rng.standard_normal((1, 4096))
    found = frf(Record(u, np.vstack([1e6 * u, 1e-10 * u]), RATE)).values
    assert np.allclose(found, [[[1e6]], [[1e-10]]], rtol=1e-9, atol=0.0)
    jitter = 0.1 * (1.0 + np.finfo(float).eps * rng.integers(-1, 2, 4096))
    for spectra in (Record(u, np.vstack([u, jitter]), RATE), cross_spectra(Record(u, np.vstack([u, jitter]), RATE))):
        with pytest.raises(InputError, match="output 'output 2' never moves"):
            frf(spectra)


def test_a_channel_that_moves_between_blocks_only_has_moved():
    rng = np.random.default_rng(0)
    u, step = rng.standard_normal(4096), np.repeat([0.1, 0.3, 0.1, 0.2], 1024)
    record = Record([u, step], [u + step], RATE)
    blocks = cross_spectra((record.part(k, k + 1024) for k in range(0, 4096, 1024)), 512)
    assert blocks.moves == cross_spectra(record, 512).moves == (True, True, True)
    assert cross_spectra(record.part(0, 1024), 512).moves == (True, False, True)


@pytest.mark.parametrize("estimator", ["H1", "H2", "Hv"])
def test_a_sensor_that_stands_still_in_one_record_has_a_gain_of_zero_there(rng, estimator):
    w, z = rng.standard_normal(4096), np.zeros(4096)
    found = frf([Record([w, z], [w, z], RATE), Record([z, w], [z, 1e-6 * w], RATE)], estimator=estimator)
    assert np.allclose(found.values, np.array([[1.0, 0.0], [0.0, 1e-6]])[:, :, np.newaxis], rtol=1e-9, atol=1e-15)
    assert found.variance is not None
    assert (found.variance[[0, 1], [1, 0]] == 0.0).all()
    assert np.isfinite(found.variance).all()


def test_h2_of_several_inputs_needs_outputs_that_move_with_them(rng):
    u = rng.standard_normal((2, 4096))
    z = np.zeros(4096)
    records = [Record([*u, z], [*(u + u[::-1] / 2), z], RATE), Record([z, z, u[0]], [z, z, u[0]], RATE)]
    assert np.isfinite(frf(records, estimator="Hv").values).all()
    with pytest.raises(InputError, match="H2 of 2 inputs needs 2 outputs, got 3"):
        frf(records, estimator="H2")
    square = [Record(r.inputs, r.outputs[[0, 2]], RATE) for r in records]
    with pytest.raises(InputError, match="output 2 stands still where several inputs are excited together"):
        frf(square, estimator="H2")


def bad_cases():
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((2, 2000)), rng.standard_normal((3, 2000))
    alike = Record([u[0], u[1], -3 * u[0]], y, RATE, actuators=["left", "middle", "right"])
    return [
        (lambda: frf(alike, 256), "'left' and 'right' move alike at 100 % of the lines"),
        (lambda: frf(Record(u, y, RATE), 256, estimator="H2"), "H2 of 2 inputs needs 2 outputs, got 3"),
        (lambda: frf(Record(u, y, RATE), estimator="H3"), "must be one of 'H1', 'H2', 'Hv'"),
        (lambda: frf(Record(u, y, RATE), estimator="Hv", noise=[1.0]), "5 densities above zero"),
        (lambda: frf(Record(u, y, RATE), 4096), "segment of 4096 samples does not fit into 2000"),
        (lambda: frf(Record(u, y, RATE), window="none such"), "there is no window 'none such'"),
        (lambda: frf(Record(u, y, RATE), detrend="cubic"), "'detrend' must be one of"),
        (lambda: frf(Record(u, [*y, np.zeros(2000)], RATE)), "output 'output 4' never moves"),
        (lambda: frf(Record(u[:, :4], y[:, :4], RATE)), "does not fit into 4 samples"),
        (lambda: frf(Record(u, y * np.nan, RATE)), "NaN"),
        (lambda: coherence(Record(0 * u, y, RATE)), "excite at least one input"),
        (lambda: cross_spectra(iter([Record(u, y, RATE)])), "blocks need 'segment_samples'"),
        (lambda: cross_spectra(iter([]), 64), "at least one block"),
        (lambda: cross_spectra(iter([Record(u[:, :9], y[:, :9], RATE)] * 3), 64), "does not fit into 27 samples"),
    ]


@pytest.mark.parametrize("case", bad_cases(), ids=lambda c: c[1])
def test_bad_input_is_a_sentence(case):
    call, words = case
    with pytest.raises(InputError) as caught:
        call()
    assert words in str(caught.value)
