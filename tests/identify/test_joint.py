"""Several records in one fit, channels tied by symmetry or poles, parts of the polynomials known."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from truths import draw

import ultraquiet as uq
from ultraquiet._base.errors import InputError, RateError
from ultraquiet.identify.joint.search import Part, Sets, posed
from ultraquiet.identify.joint.ties import Ties
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation

RATE_HZ = 3500.0
NOISE_C, NOISE_D = np.array([1.0, 0.5]), np.array([1.0, -0.9])


def mode(f_hz, zeta, rate_hz=RATE_HZ):
    s = 2 * np.pi * f_hz * (-zeta + 1j * np.sqrt(1 - zeta**2))
    return np.poly([np.exp(s / rate_hz), np.exp(np.conj(s) / rate_hz)]).real


def normed(b, f):
    b = np.concatenate([[0.0], b])
    return b / np.linalg.norm(lfilter(b, f, np.eye(1, 50_000)[0])), f


def noise(rng, samples, size=0.1):
    v = lfilter(NOISE_C, NOISE_D, rng.standard_normal(samples + 2000))[2000:]
    return size * v / v.std()


def column_records(functions, rng, samples):
    """One record per actuator of a matrix of (b, f)."""
    ny, nu = len(functions), len(functions[0])
    records = []
    for k in range(nu):
        u = np.zeros((nu, samples))
        u[k] = rng.standard_normal(samples)
        y = [lfilter(*functions[i][k], u[k]) + noise(rng, samples) for i in range(ny)]
        records.append(uq.Record(u, np.array(y), RATE_HZ))
    return records


def deviation(covariance):
    return np.sqrt(np.diag(covariance))


@pytest.mark.slow
def test_two_halves_are_worth_the_whole(rng):
    method = uq.identify.BoxJenkins(order=5, focus="prediction")
    ratios, spreads = [], []
    for _ in range(8):
        drawn = draw("suite_rate", rng, samples=8192)
        whole = method.identify(drawn.record)
        halves = method.identify([drawn.record.part(0, 4096), drawn.record.part(4096)])
        ratios.append(halves.loss[0] / np.mean(drawn.innovations**2))
        spreads.append(np.median(deviation(halves.covariance[0]) / deviation(whole.covariance[0])))
        assert halves.model.is_stable()
        assert halves.model.is_invertible()
    print(
        f"\ntwo halves in one fit: loss {np.median(ratios):.4f} of the truth's (worst {max(ratios):.4f}), standard "
        f"deviations {np.median(spreads):.3f} times those of the whole (worst {max(spreads):.3f})"
    )
    assert np.median(ratios) == pytest.approx(1.0, abs=0.02)
    assert np.median(spreads) == pytest.approx(1.0, abs=0.03)


def test_experiments_of_different_length_and_level_share_one_model(rng):
    b, f = normed([1.0, -0.9], mode(40, 0.05))
    records = []
    for samples, level in ((1500, 1.0), (2000, 1.5), (900, 0.5)):
        u = level * rng.standard_normal(samples + 300)
        y = lfilter(b, f, u) + noise(rng, samples + 300)
        records.append(uq.Record(u[300:], y[300:] + 3.0 * level, RATE_HZ))  # in motion from the start, its own offset
    method = uq.identify.BoxJenkins(order=2, c_order=1, d_order=1, focus="prediction")
    alone = [method.identify(r) for r in records]
    joint = method.identify(records)
    m = joint.model.rows[0][0]
    pulls = (m.f[0] - f)[1:] / deviation(joint.covariance[0])[2:4]
    added = np.linalg.inv(sum(np.linalg.inv(r.covariance[0]) for r in alone))
    ratio = deviation(joint.covariance[0]) / deviation(added)
    print(f"\n{joint.status}; f off by {pulls.round(1)} deviations, which are {ratio.round(2)} of the records' sum")
    assert np.all(np.abs(pulls) < 5)
    assert ratio == pytest.approx(np.ones(6), rel=0.25)


def six_functions(rng):
    def one():
        f = np.convolve(mode(12 * np.exp(0.2 * rng.standard_normal()), 0.03), mode(55, 0.01))
        sign = 1 if rng.random() < 0.5 else -1
        return normed(sign * np.convolve(mode(30, 0.05), [1.0, -np.exp(-2 * np.pi * 200 / RATE_HZ)]), f)

    return [one() for _ in range(6)]


@pytest.mark.slow
def test_threefold_symmetry_saves_the_square_root_of_its_copies(rng):
    labels = Ties.of("threefold", 6, 6).functions
    assert np.array_equal(np.bincount(labels.ravel()), [6] * 6)
    functions = six_functions(rng)
    records = column_records([[functions[c] for c in row] for row in labels], rng, 4096)
    method = uq.identify.BoxJenkins(order=4, c_order=1, d_order=1, focus="prediction")
    free = uq.identify.identify_matrix(method, records)
    begun, seconds = time.perf_counter(), time.process_time()
    tied = uq.identify.identify_matrix(method, records, ties="threefold")
    begun, seconds = time.perf_counter() - begun, time.process_time() - seconds
    quiet = uq.identify.identify_matrix(method, records, ties=("threefold", "noise"))

    def errors(result):
        """Errors of b and f, in standard deviations of the free fit and in its independent directions."""
        out = []
        for i, k in np.ndindex(6, 6):
            m, (b, f) = result.model.rows[i][k], functions[labels[i, k]]
            P, size = free.covariance[i, k][:8, :8], deviation(free.covariance[i, k])[:8]
            values, vectors = np.linalg.eigh(P / np.outer(size, size))
            miss = vectors.T @ (np.concatenate([m.b[0][1:] - b[1:], m.f[0][1:] - f[1:]]) / size)
            seen = values > 1e-9 * values[-1]
            out += list(miss[seen] / np.sqrt(values[seen]))
        return np.sqrt(np.mean(np.square(out)))

    told = np.median([deviation(free.covariance[p])[:8] / deviation(tied.covariance[p])[:8] for p in np.ndindex(6, 6)])
    print(f"\nerrors in deviations of the free fit: free {errors(free):.2f}, tied {errors(tied):.2f}")
    print(
        f"threefold: error {errors(free) / errors(tied):.2f} times smaller (the square root of 6 is 2.45), with one "
        f"noise model {errors(free) / errors(quiet):.2f}; deviations told {told:.2f} times smaller; {seconds:.1f} "
        f"processor seconds, {begun:.1f} on the clock; {tied.status}"
    )
    same = [tied.model.rows[i][k].f[0] for i, k in np.argwhere(labels == 3)]
    assert max(np.abs(p - same[0]).max() for p in same) < 1e-12
    assert told == pytest.approx(np.sqrt(6), rel=0.1)
    # 48 parameters: the ratio scatters by a tenth.
    assert errors(free) / errors(tied) > 1.8
    assert seconds < 5


def test_symmetry_of_the_bench_is_threefold():
    G = np.asarray(uq.bench.Hexapod(unit="ground", spread=0.0).linear_response(np.array([10.0, 30.0, 80.0])))
    labels = Ties.of("threefold", 6, 6).functions
    spread = max(np.abs(G[labels == c] - G[labels == c].mean(axis=0)).max() for c in range(6)) / np.abs(G).max()
    print(f"\nfunctions of one label differ by {spread:.1e} on a hexapod of equal struts")
    assert spread < 1e-9


def test_zeros_at_dc_are_exact_and_sharpen_the_low_end(rng):
    b, f = normed(np.convolve([1.0, -2.0, 1.0], [1.0, -0.7]), np.convolve(mode(12, 0.3), mode(55, 0.05)))
    lines = np.array([1.0, 2.0, 4.0])
    G = uq.PolynomialModel([b], [f], RATE_HZ).frequency_response(lines)[0, 0]
    free = uq.identify.BoxJenkins(order=4, c_order=1, d_order=1, focus="prediction")
    known = replace(free, zeros_at_dc=2)
    misses, losses = [], []
    for _ in range(10):
        u = rng.standard_normal(4096)
        record = uq.Record(u, lfilter(b, f, u) + noise(rng, 4096), RATE_HZ)
        results = [free.identify(record), known.identify(record)]
        misses.append([np.abs(r.model.frequency_response(lines)[0, 0] - G) for r in results])
        losses.append(results[1].loss[0] / results[0].loss[0])
    model = results[1].model.rows[0][0]
    still = np.abs(model.frequency_response([0.0])).max() / np.abs(model.frequency_response([12.0])).max()
    ratio = np.median([m[0] / m[1] for m in misses], axis=0)
    print(
        f"\nzeros at z = 1: gain at 0 Hz {still:.0e} of that at 12 Hz; errors at 1, 2, 4 Hz {ratio.round(1)} times "
        f"smaller; loss {np.median(losses):.4f} times"
    )
    assert still < 1e-9
    assert results[1].covariance[0].shape == (10, 10)
    assert np.linalg.matrix_rank(results[1].covariance[0][:4, :4], tol=1e-9 * results[1].covariance[0][0, 0]) == 2
    assert np.all(ratio > 2)
    assert np.median(losses) < 1.01


def test_shared_poles_are_better_than_separate_ones(rng):
    f = np.convolve(mode(12, 0.03), mode(55, 0.01))
    ratios, deviations = [], []
    for _ in range(4):
        functions = [
            [normed(g * np.convolve(mode(z, 0.05), [1.0, -0.5]), f) for g, z in row]
            for row in (((1, 30), (-1, 20)), ((1, 90), (1, 35)))
        ]
        records = column_records(functions, rng, 3000)
        method = uq.identify.BoxJenkins(order=4, c_order=1, d_order=1, focus="prediction")
        free = uq.identify.identify_matrix(method, records)
        tied = uq.identify.identify_matrix(method, records, ties="poles")
        errors = [
            np.mean([np.linalg.norm(np.roots(m.f[0]) - np.roots(f)) for row in r.model.rows for m in row])
            for r in (free, tied)
        ]
        ratios.append(errors[0] / errors[1])
        deviations.append(np.median(deviation(free.covariance[0, 0])[4:8] / deviation(tied.covariance[0, 0])[4:8]))
        assert len({m.f[0].tobytes() for row in tied.model.rows for m in row}) == 1
    print(f"\npoles shared by 2 x 2: errors {np.round(ratios, 2)} times smaller, deviations {np.round(deviations, 2)}")
    assert np.median(ratios) > 1.3


def test_poles_shared_by_input_and_symmetric_matrices(rng):
    f = [mode(12, 0.05), mode(40, 0.05)]
    g = [[normed([1.0, -0.5], f[k]) for k in range(2)] for _ in range(2)]
    records = column_records(g, rng, 2000)
    method = uq.identify.OutputError(order=2)
    tied = uq.identify.identify_matrix(method, records, ties="poles-by-input").model.rows
    assert np.array_equal(tied[0][0].f[0], tied[1][0].f[0])
    assert not np.array_equal(tied[0][0].f[0], tied[0][1].f[0])
    rows = uq.identify.identify_matrix(method, records, ties="poles-by-output").model.rows
    assert np.array_equal(rows[0][0].f[0], rows[0][1].f[0])
    mirrored = uq.identify.identify_matrix(method, records, ties="symmetric").model.rows
    assert np.array_equal(mirrored[0][1].f[0], mirrored[1][0].f[0])
    assert mirrored[0][1].b[0] == pytest.approx(mirrored[1][0].b[0], rel=1e-9)


def test_one_record_of_all_inputs_may_be_tied_too(rng):
    b, f = normed([1.0, -0.5], mode(60, 0.1))
    c, g = normed([1.0, 0.5], mode(25, 0.1))
    u = rng.standard_normal((2, 4000))
    same, cross = [lfilter(b, f, x) for x in u], [lfilter(c, g, x) for x in u]
    y = np.array([same[0] + cross[1] + noise(rng, 4000), cross[0] + same[1] + noise(rng, 4000)])
    method = uq.identify.BoxJenkins(order=2, c_order=1, d_order=1, focus="prediction")
    result = uq.identify.identify_joint(method, [uq.Record(u, y, RATE_HZ)], ties=[[0, 1], [1, 0]])
    first, second = (row[0] for row in result.model.rows)
    misses = [np.abs(first.f[0] - f).max(), np.abs(first.f[1] - g).max()]
    print(f"\n{result.status}; diagonal poles off by {misses[0]:.1e}, others by {misses[1]:.1e}")
    assert np.array_equal(first.f[0], second.f[1])
    assert np.array_equal(first.f[1], second.f[0])
    assert first.f[0] == pytest.approx(f, abs=0.005)
    assert first.f[1] == pytest.approx(g, abs=0.005)


def test_delays_and_orders_per_input(rng):
    u = rng.standard_normal((2, 4096))
    y = lfilter([0, 0, 0, 1.0], [1, -0.9], u[0]) + lfilter([0, 0.5, 0.2], [1, -0.5, 0.3], u[1])
    y += lfilter([1, 0.5], [1, -0.8], 0.1 * rng.standard_normal(4096))
    method = uq.identify.BoxJenkins(order=1, delay=(3, 1), b_order=(1, 2), f_order=(1, 2))
    result = method.identify(uq.Record(u, y, 100.0))
    m = result.model.rows[0][0]
    print(f"\n{result.status}; b {[p.round(3).tolist() for p in m.b]}, f {[p.round(3).tolist() for p in m.f]}")
    assert m.b[0] == pytest.approx([0, 0, 0, 1.0], abs=0.03)
    assert m.b[1] == pytest.approx([0, 0.5, 0.2], abs=0.03)
    assert m.f[1] == pytest.approx([1, -0.5, 0.3], abs=0.05)
    assert result.covariance.shape == (1, 8, 8)


def test_known_poles_and_polynomials_are_kept(rng):
    known, other = mode(12, 0.05), mode(55, 0.05)
    b, f = normed(np.convolve(mode(30, 0.05), [1.0, -0.7]), np.convolve(known, other))
    u = rng.standard_normal(4096)
    record = uq.Record(u, lfilter(b, f, u) + noise(rng, 4096), RATE_HZ)
    free = uq.identify.BoxJenkins(order=4, c_order=1, d_order=1, focus="prediction")
    some = replace(free, known_poles=tuple(np.roots(known))).identify(record)
    rest = replace(free, fixed={"f": tuple(f), "c": (1.0, 0.5), "d": (1.0, -0.9)}).identify(record)
    plain = free.identify(record)
    pairs = replace(free, known_poles=[[p.real, p.imag] for p in np.roots(known)])
    assert np.array_equal(
        pairs.parameterisation(1).known, replace(free, known_poles=tuple(np.roots(known))).parameterisation(1).known
    )
    m = some.model.rows[0][0]
    left = np.polydiv(m.f[0], known)[1]
    print(f"\nknown pair leaves {np.abs(left).max():.0e}; losses {some.loss / plain.loss}, {rest.loss / plain.loss}")
    assert np.abs(left).max() < 1e-9
    assert some.loss[0] < 1.01 * plain.loss[0]
    assert np.array_equal(rest.model.rows[0][0].f[0], f)
    assert np.all(deviation(rest.covariance[0])[4:] == 0)
    assert np.all(deviation(rest.covariance[0])[:4] < deviation(plain.covariance[0])[:4])


def test_arx_and_armax_take_several_records_and_known_zeros(rng):
    a, c = np.array([1.0, -1.6, 0.8]), np.array([1.0, 0.7, 0.2])
    b = np.array([0.0, 1.0, -1.0])
    for method, filtered in ((uq.identify.Arx, [1.0]), (uq.identify.Armax, c)):
        records = []
        for _ in range(2):
            u, e = rng.standard_normal((2, 2000))
            records.append(uq.Record(u, lfilter(b, a, u) + lfilter(filtered, a, 0.1 * e), 100.0))
        result = method(order=2, zeros_at_dc=1).identify(records)
        m = result.model.rows[0][0]
        print(f"\n{method.__name__}: {result.status}; a {m.a.round(3)}, b {m.b[0].round(3)}")
        assert m.a == pytest.approx(a, abs=0.02)
        assert m.b[0] == pytest.approx(b, abs=0.02)
        assert abs(m.b[0].sum()) < 1e-12


def test_gradient_of_the_joint_criterion(rng):
    """Ties, scales, known zeros and poles at once: the slope promised is the slope found by differences.

    The noise's zero and pole stand apart: where they nearly meet, two states of the past are nearly one, and the slope
    turns within the step of the differences.
    """
    known = np.poly([0.5]).real
    layout = Parameterisation(0, 1, 1, (3, 2), (2, 3), (1, 2), zeros_at_dc=1, known=known)
    parts, tables = [], []
    for group, samples in ((0, 400), (0, 300), (1, 350)):
        data = ChannelData(rng.standard_normal((2, samples)) * [[1.0], [3.0]], 2.0 * rng.standard_normal(samples))
        keys = (None, ("c", group), ("d", 0), ("b", 0), ("f", 0), ("b", group + 1), ("f", 1))
        parts.append(Part(data, layout, group, keys, layout.states(True, True)))
    problem = posed(parts)
    for part in parts:
        table = layout.empty(part.data.gain)
        table[1:3, 1] = -0.4, 0.6
        layout.with_poles(table, 4, np.array([0.5, -0.3 + 0j]))
        layout.with_poles(table, 6, np.array([0.5, 0.6 + 0.3j, 0.6 - 0.3j]))
        tables.append(table)
    start = Sets(problem, map).at(tables).moved(0.01 * rng.standard_normal(problem.size))
    step = rng.standard_normal(problem.size)
    W = [start.moved(h * step).criterion for h in (1e-6, -1e-6)]
    S = start.normal()
    slope, promised = (W[0] - W[1]) / 2e-6, 2 * S[:-1, -1] @ step
    print(f"\n{problem.size} unknowns of three sets: slope {promised:.6g} by filters, {slope:.6g} by differences")
    assert promised == pytest.approx(slope, rel=1e-3, abs=1e-2)


def test_unlike_experiments_are_refused(rng):
    method = uq.identify.OutputError(order=1)
    u, y = rng.standard_normal((2, 2, 500))
    first = uq.Record(u, y, 100.0)
    with pytest.raises(InputError, match=r"OutputError: no records were given"):
        method.identify([])
    with pytest.raises(RateError, match=r"record 1 is sampled at 100 Hz but record 2 is sampled at 200 Hz"):
        method.identify([first, uq.Record(u, y, 200.0)])
    with pytest.raises(InputError, match=r"record 1 has 2 outputs but record 2 has 1"):
        method.identify([first, uq.Record(u, y[:1], 100.0)])
    other = uq.Record(u, y, 100.0, sensors=[uq.Channel("output 1", "m/s", -10, 10), first.sensors[1]])
    with pytest.raises(
        InputError, match=r"output 'output 1' in no unit of record 1 meets 'output 1' in 'm/s' of record 2"
    ):
        method.identify([first, other])
    with pytest.raises(InputError, match=r"BoxJenkins: records in one fit.*one-step error alone"):
        uq.identify.BoxJenkins(order=1, focus="simulation").identify([first, first])
    with pytest.raises(InputError, match=r"the record has 20 samples"):
        method.identify([first, first.part(0, 20)])


def test_impossible_ties_are_refused(rng):
    method = uq.identify.OutputError(order=1)
    u, y = rng.standard_normal((2, 2, 500))
    sensors = [uq.Channel("g1", "V", -10, 10), uq.Channel("a1", "m/s2", -10, 10)]
    record = uq.Record(u, y, 100.0, sensors=sensors)
    with pytest.raises(InputError, match=r"sensors 'g1' in 'V' and 'a1' in 'm/s2' cannot share a transfer function"):
        uq.identify.identify_joint(method, [record], ties="symmetric")
    record = uq.Record(u, y, 100.0)
    with pytest.raises(InputError, match=r"'threefold' needs a 6 x 6 matrix of channels, got 2 x 2"):
        uq.identify.identify_joint(method, [record], ties="threefold")
    with pytest.raises(InputError, match=r"'symetric' is unknown; known are threefold"):
        uq.identify.identify_joint(method, [record], ties="symetric")
    with pytest.raises(InputError, match=r"labels must be whole numbers, one per channel, \(2, 2\)"):
        uq.identify.identify_joint(method, [record], ties=[[0, 1]])
    with pytest.raises(InputError, match=r"ARX and ARMAX give all inputs of an output one denominator"):
        uq.identify.identify_joint(uq.identify.Arx(order=1), [record], ties="symmetric")


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"zeros_at_dc": 2}, "2 coefficients of B hold no 2 zeros"),
        ({"known_poles": (1.2,)}, "inside the unit circle"),
        ({"known_poles": (0.5 + 0.2j,)}, "conjugate pairs"),
        ({"known_poles": (0.5, 0.6, 0.7)}, "holds no 3 known poles"),
        ({"fixed": {"g": (1.0,)}}, "'fixed' must be one of"),
        ({"fixed": {"c": (2.0, 0.1)}}, "beginning with one"),
        ({"fixed": {"a": (1.0, 0.1)}}, "no 'a' to fix"),
        ({"delay": (1, 2, 3)}, "'delay' has 3 values for 1 inputs"),
        ({"delay": (1, -1)}, "'delay' must be"),
    ],
    ids=str,
)
def test_impossible_knowledge_is_refused(settings, sentence, rng):
    record = uq.Record(rng.standard_normal(500), rng.standard_normal(500), 100.0)
    with pytest.raises(InputError, match=sentence):
        uq.identify.BoxJenkins(order=2, **settings).identify(record)


def test_share_is_the_older_name_of_ties(rng):
    method = uq.identify.OutputError(order=1)
    u, y = rng.standard_normal((2, 2, 500))
    record = uq.Record(u, y, 100.0)
    older, newer = (uq.identify.identify_joint(method, [record], **{name: "symmetric"}) for name in ("share", "ties"))
    assert all(np.array_equal(p.b[0], q.b[0]) for p, q in zip(older.model.rows[0], newer.model.rows[0], strict=True))
    with pytest.raises(InputError, match=r"'share' is the older name of 'ties'"):
        uq.identify.identify_matrix(method, [record], ties="symmetric", share="symmetric")
