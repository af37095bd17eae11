"""Designs without any setting: robust on ordinary plants, whatever their shape, and the same in any units."""

import functools
import time

import numpy as np
import pytest
from ordinary_plants import closed_loop_radius, ordinary, with_units

from ultraquiet.analyse import disk_margin, disk_ranges, hinf_norm
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.design import BandAttenuation, FixedStructure, Lqg, MixedSensitivity, PeakBounded
from ultraquiet.values import StateSpace

DESIGNS = [Lqg, MixedSensitivity, BandAttenuation]
SEARCHES = [PeakBounded, FixedStructure]
SIDES = ("input", "output")
DB, DEGREES = 1.0, 5.0  # what a channel of ordinary care may be off by
QUIETER_DB, SEARCHED_DB = 10.0, 5.0
LITTLE_DB = 0.5  # less is as good as no law
PLANTS, SEARCHED, DRAWS = 200, 20, 5
SHARE_OK, SHARE_QUIETER = 0.9, 0.8


def channels(plant, side):
    return plant.D.shape[1] if side == "input" else plant.D.shape[0]


def upset_by_one_channel(plant, law):
    """Return which single changes of 1 dB or 5 degrees leave an unstable loop."""
    off = []
    for side in SIDES:
        count = channels(plant, side)
        for i in range(count):
            for name, factor in (
                (f"+{DB} dB", 10 ** (DB / 20)),
                (f"-{DB} dB", 10 ** (-DB / 20)),
                (f"{DEGREES} degrees", np.exp(1j * np.radians(DEGREES))),  # a real loop: minus the phase is the same
            ):
                factors = np.ones(count, complex)
                factors[i] = factor
                if closed_loop_radius(plant, law, side, factors) >= 1:
                    off.append(f"{name} of {side} {i + 1}")
    return off


def upset_within_the_disk(rng, plant, law, alpha=0.2, draws=DRAWS):
    """Return which draws of all channels at once, each on the edge of the disk, leave an unstable loop."""
    off = []
    for side in SIDES:
        for _ in range(draws):
            d = alpha * np.exp(2j * np.pi * rng.random(channels(plant, side)))
            if closed_loop_radius(plant, law, side, (2 + d) / (2 - d)) >= 1:
                off.append(f"disk of {side}s")
    return off


@functools.lru_cache
def of_defaults(design, shape, seed):
    """Return what a default makes of a drawn plant, and the plant."""
    plant = ordinary(np.random.default_rng(seed), shape, modes=4)
    return design().design(plant), plant


@pytest.mark.parametrize(
    ("design", "shape"),
    [
        (Lqg, (1, 1)),
        (Lqg, (3, 5)),
        (MixedSensitivity, (4, 3)),
        (BandAttenuation, (2, 3)),
        (PeakBounded, (1, 1)),
        pytest.param(PeakBounded, (3, 5), marks=pytest.mark.slow),
        (FixedStructure, (2, 2)),
        pytest.param(FixedStructure, (4, 3), marks=pytest.mark.slow),
    ],
)
def test_a_default_stands_what_ok_promises(seed, design, shape):
    result, plant = of_defaults(design, shape, seed)
    if not result.status.ok:
        assert design in SEARCHES, result.status
        return
    assert min(result.margins[side].disk_all for side in SIDES) >= 0.2
    assert not upset_by_one_channel(plant, result.controller)
    assert not upset_within_the_disk(np.random.default_rng(seed), plant, result.controller, draws=20)


@pytest.mark.parametrize(
    ("design", "shape"),
    [
        # 10 dB on eight of ten are promised: 15 of 200, 2, 3 and 3 of 100 such plants get less
        pytest.param(Lqg, (1, 1), marks=pytest.mark.draws(false_alarm=0.1)),
        pytest.param(Lqg, (3, 5), marks=pytest.mark.draws(false_alarm=0.05)),
        pytest.param(MixedSensitivity, (4, 3), marks=pytest.mark.draws(false_alarm=0.06)),
        pytest.param(BandAttenuation, (2, 3), marks=pytest.mark.draws(false_alarm=0.06)),
        # three of fifty such plants end short, by 0.1 to 3 dB; ok on nine of ten is promised
        pytest.param(PeakBounded, (1, 1), marks=pytest.mark.draws(false_alarm=0.1)),
        # one of a hundred each ends at 1 to 4 dB, where another search finds more
        pytest.param(PeakBounded, (3, 5), marks=[pytest.mark.slow, pytest.mark.draws(false_alarm=0.02)]),
        pytest.param(FixedStructure, (2, 2), marks=pytest.mark.draws(false_alarm=0.02)),
        pytest.param(FixedStructure, (4, 3), marks=[pytest.mark.slow, pytest.mark.draws(false_alarm=0.02)]),
    ],
)
def test_a_default_is_ok_and_quiet(seed, design, shape):
    """The searches ask for less where every direction has to stay below a peak."""
    result, _ = of_defaults(design, shape, seed)
    assert result.status.ok, result.status
    assert result.details["attenuation_rms_db"] > (SEARCHED_DB if design in SEARCHES else QUIETER_DB)


@pytest.mark.gate("Lqg")
@pytest.mark.parametrize("design", DESIGNS)
def test_other_units_change_neither_the_design_nor_the_verdict(seed, design):
    rng = np.random.default_rng(seed + 20)
    plant = ordinary(rng, (2, 2), modes=3)
    first = design().design(plant)
    f = np.geomspace(1e-3, 0.45, 60) * plant.rate_hz
    K = first.controller.frequency_response(f)
    for units in (
        {"inputs": [1e9, 1e-9]},
        {"outputs": [1e-9, 1e9]},
        {"states": 10.0 ** rng.choice([-9, 0, 9], plant.states)},
    ):
        other = design().design(with_units(plant, **units))
        assert other.status.word == first.status.word
        assert other.details["gain"] == first.details["gain"]
        back = with_units(other.controller, inputs=units.get("outputs", 1.0), outputs=units.get("inputs", 1.0))
        assert np.linalg.norm(back.frequency_response(f) - K) < 1e-4 * np.linalg.norm(K)
        for side in SIDES:
            assert other.margins[side].disk_all == pytest.approx(first.margins[side].disk_all, rel=1e-3)


def weighs_alike(plant):
    """Assert that rows and columns have mean square one over the plant's own band, and that it is quiet outside."""
    even = even_plant(plant)
    low, high = even.band_hz
    G = even.plant.frequency_response(even.f_hz)
    widths = np.gradient(even.f_hz)
    mean = (np.abs(G) ** 2 * widths).sum(axis=2) / widths.sum()
    assert np.allclose(mean.mean(axis=0), 1.0, rtol=0.05)
    assert np.allclose(mean.mean(axis=1), 1.0, rtol=0.05)
    outside = np.concatenate(
        [np.geomspace(low / 10, 0.99 * low, 50), np.geomspace(1.01 * high, 0.49 * plant.rate_hz, 50)]
    )
    largest = np.linalg.norm(np.moveaxis(G, 2, 0), 2, axis=(1, 2)).max()
    beyond = np.linalg.norm(np.moveaxis(even.plant.frequency_response(outside), 2, 0), 2, axis=(1, 2))
    assert beyond.max() < 0.1 * largest


# Of 3000 plants 46 are off by 5 to 16 % as summed here, none as summed over all lines: the first and the last of the
# band weigh otherwise there, which counts where a mode stands at its edge or there are twenty lines.
@pytest.mark.draws(false_alarm=0.015)
def test_rows_and_columns_of_an_even_plant_weigh_alike_over_its_own_band(seed):
    weighs_alike(ordinary(np.random.default_rng(seed), (4, 3)))


@pytest.mark.parametrize(("drawn", "shape"), [(53, (4, 3)), (53, (3, 5)), (15, (3, 5))])
def test_they_do_where_a_mode_stands_at_the_edge_of_the_band(drawn, shape):
    """By the scales of a band without it the mode is within 20 dB of the largest, by those of one with it beyond."""
    weighs_alike(ordinary(np.random.default_rng(drawn), shape))


def test_a_channel_without_effect_is_left_alone():
    plant = StateSpace([[0.9]], [[1.0, 0.0]], [[1.0], [0.0]], np.zeros((2, 2)), 100.0)
    result = Lqg().design(plant)
    assert result.status.ok
    assert np.isfinite(result.controller.D).all()


def test_numbers_that_are_given_are_what_is_designed_for(seed):
    """The weight on u in units of the plant: far below what u moves, as 1e-3 is of 1e6, a loop hangs on rounding."""
    plant = ordinary(np.random.default_rng(seed), (2, 2), modes=3)
    control = 1e-2 * hinf_norm(plant)[0]
    result = Lqg(control_weight=control**2, sensor_noise=1e-2, disturbance_at="input").design(plant)
    assert "gain" not in result.details
    assert result.details["weights"]["control"].D[0, 0] == pytest.approx(control)


def test_a_default_asked_for_more_margin_takes_less_gain(seed):
    rng = np.random.default_rng(seed)
    while True:  # some plants keep as much at the first gain
        plant = ordinary(rng, (2, 2), modes=3)
        little = Lqg(disk_margin=0.1).design(plant)
        if min(disk_margin(plant, little.controller, side) for side in SIDES) < 0.9:
            break
    much = Lqg(disk_margin=0.9).design(plant)
    assert much.status.ok, much.status
    assert much.details["gain"] < little.details["gain"]
    assert much.details["attenuation_rms_db"] < little.details["attenuation_rms_db"]
    assert disk_ranges(0.9)[0] < disk_ranges(0.1)[0]


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.draws(false_alarm=5e-3)  # of a fifth: 9 of 40 less quiet where 15 of 200 were of the loudest design
@pytest.mark.parametrize("design", DESIGNS)
def test_defaults_on_two_hundred_plants(seed, design, cases):
    """Ok on nine of ten, 10 dB less RMS of S G in the band on eight of ten, never ok without standing its promise."""
    rng, plants = np.random.default_rng(seed), cases(PLANTS)
    words, reductions, broken, quiet = [], [], [], 0
    for k in range(plants):
        plant = ordinary(rng)
        result = design().design(plant)
        words.append(str(result.status.word))
        if result.controller is None:
            continue
        reductions.append(result.details["attenuation_rms_db"])
        quiet += reductions[-1] >= QUIETER_DB
        own = result.controller.is_stable() or "unstable by itself" in result.status.sentence
        if not own:
            broken.append(f"plant {k}: the law is unstable and nobody says so")
        if result.status.ok:
            off = upset_by_one_channel(plant, result.controller)
            off += upset_within_the_disk(rng, plant, result.controller)
            broken += [f"plant {k}, {plant.D.shape}: {change}" for change in off]
    print(
        f"{design.__name__}: {words.count('ok')} of {plants} ok, {words.count('fragile')} fragile, "
        f"{words.count('refused')} refused; {quiet} quieter by {QUIETER_DB:g} dB, median "
        f"{np.median(reductions):.1f} dB, least {np.min(reductions):.1f} dB; promises broken: {len(broken)}"
    )
    assert not broken, broken[:10]
    assert words.count("ok") >= SHARE_OK * plants
    assert quiet >= SHARE_QUIETER * plants


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("design", SEARCHES)
def test_defaults_that_search_on_twenty_plants(design):
    """Never ok without standing its promise; the words are counted, and how quiet the laws are."""
    rng, rows, broken = np.random.default_rng(1), [], []
    for k in range(SEARCHED):
        plant = ordinary(rng)
        began = time.process_time()
        result = design().design(plant)
        even, law, word = even_plant(plant), result.controller, str(result.status.word)
        quieter = np.nan if law is None else even.rms_reduction_db(_of_even(even, law))
        rows.append((word, quieter))
        if result.status.ok:
            off = upset_by_one_channel(plant, law) + upset_within_the_disk(rng, plant, law)
            broken += [f"plant {k}, {plant.D.shape}: {change}" for change in off]
        seconds = time.process_time() - began
        print(f"plant {k}, {plant.D.shape}: {quieter:.1f} dB, {seconds:.0f} s, {str(result.status)[:150]}", flush=True)
    words, quiet = [word for word, _ in rows], np.array([db for _, db in rows])
    found = quiet[np.isfinite(quiet)]
    counted = {word: words.count(word) for word in sorted(set(words))}
    print(
        f"{design.__name__}: {counted}; {(found >= QUIETER_DB).sum()} "
        f"quieter by {QUIETER_DB:g} dB, median {np.median(found):.1f} dB; promises broken: {len(broken)}"
    )
    assert not broken, broken[:10]
    idle = [f"plant {k}: {db:.2f} dB" for k, (word, db) in enumerate(rows) if word == "ok" and db < LITTLE_DB]
    assert not idle, idle
    assert words.count("ok") >= SHARE_OK * SEARCHED
    assert (found >= QUIETER_DB).sum() >= SHARE_QUIETER * SEARCHED


def _of_even(even, law):
    """Return a plant's law in the units of its even plant."""
    u, y = even.inputs[:, None], even.outputs
    return StateSpace(law.A, law.B / y, law.C / u, law.D / u / y, law.rate_hz)


@pytest.mark.parametrize("ratio", [1e3, 1e6, 1e12])
def test_units_that_nobody_stated_change_no_word_of_the_worst_direction(ratio):
    """A sensor a million times as faint as another is not out of reach: no law of its own units would say so."""
    plant = even_plant(ordinary(np.random.default_rng(5), (2, 2), modes=3)).plant
    said = []
    for outputs in ([1.0, ratio], [1.0, 100.0 * ratio]):
        other = with_units(plant, outputs=outputs)
        result = Lqg().design(other)
        assert "no law makes anything quieter" not in result.status.sentence
        said.append(result.status.sentence.rpartition("worst direction")[2])
    assert said[0] == said[1]
