"""Proof masses and tri-axial geophones beside the struts: two routes agree, momentum is kept, laws run."""

import numpy as np
import pytest

from ultraquiet import StateSpace, signals
from ultraquiet._base.errors import InputError
from ultraquiet.bench import Hexapod
from ultraquiet.bench.hexapod.physics.monitors import TILT_DEG, triaxial_axes
from ultraquiet.bench.hexapod.physics.parameters import PAYLOAD
from ultraquiet.values import SteppedController

UNITS = ("ground", "flight", "rigid")
RATE = 3500.0
WIDE = np.geomspace(1.0, 1500.0, 160)


def law_of(rng, ny, nu, states=4):
    A = np.diag(rng.uniform(-0.9, 0.9, states))
    return StateSpace(
        A,
        1e-2 * rng.normal(size=(states, ny)),
        1e-2 * rng.normal(size=(nu, states)),
        1e-3 * rng.normal(size=(nu, ny)),
        rate_hz=RATE,
    )


def test_channels_have_names_units_and_limits():
    bench = Hexapod(instruments="all")
    assert [c.name for c in bench.actuators[6:]] == ["base proof mass", "payload proof mass"]
    expected = [f"{body} {axis}" for body in ("base", "payload") for axis in "xyz"]
    assert [c.name for c in bench.sensors[6:]] == expected
    assert [c.high for c in bench.actuators] == [25.0] * 6 + [10.0] * 2
    assert {(c.unit, c.high) for c in bench.sensors} == {("V", 10.0)}
    assert len(Hexapod().actuators) == len(Hexapod().sensors) == 6
    with pytest.raises(InputError, match="'instruments' must be one of 'struts', 'all'"):
        Hexapod(instruments="some")


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_the_state_space_agrees_with_the_frequency_domain(unit, spread, seed):
    bench = Hexapod(unit=unit, instruments="all", spread=spread, unit_seed=seed)
    model, truth = bench.linear_model().frequency_response(WIDE), bench.linear_response(WIDE)
    assert truth.shape == (12, 8, WIDE.size)
    # What a rigid floor hides has no gain to compare; elsewhere every channel has one.
    seen = np.abs(truth) > 1e-12
    assert seen.all() or unit == "rigid"
    ratio = (model / np.where(seen, truth, 1.0))[seen]
    gain, phase = np.abs(20 * np.log10(np.abs(ratio))).max(), np.degrees(np.abs(np.angle(ratio))).max()
    print(f"{unit}, spread {spread:g}: {gain:.1e} dB, {phase:.1e} degrees at worst over 96 channels, 1-1500 Hz")
    assert gain < 0.1
    assert phase < 1.0


@pytest.mark.gate("ground", "rigid")
@pytest.mark.parametrize("unit", UNITS)
def test_the_sampled_run_has_the_analytic_response(unit):
    """One pulse through each actuator of the linear bench, transformed: the simulation itself, not its model."""
    bench, n = Hexapod(unit=unit, instruments="all", linear=True), 2**15
    f_hz = np.fft.rfftfreq(n, 1 / RATE)
    band = (f_hz >= 1.0) & (f_hz <= 1500.0)
    # Every 23rd line is enough, and the proof mass and a strut stand for all: linear in all of them.
    lines = np.flatnonzero(band)[::23]
    truth = bench.linear_response(f_hz[lines])
    worst_db = worst_deg = 0.0
    for actuator in (0, 7):
        u = np.zeros((8, n))
        u[actuator, 0] = 1.0
        answer = np.fft.rfft(bench.run(u).outputs)[:, lines]
        seen = np.abs(truth[:, actuator]).max(axis=1) > 1e-12
        ratio = (answer / np.where(seen[:, None], truth[:, actuator], 1.0))[seen]
        worst_db = max(worst_db, np.abs(20 * np.log10(np.abs(ratio))).max())
        worst_deg = max(worst_deg, np.degrees(np.abs(np.angle(ratio))).max())
    print(f"{unit}: simulated against analytic {worst_db:.1e} dB, {worst_deg:.1e} degrees")
    assert worst_db < 0.1
    assert worst_deg < 1.0


def test_a_rigid_floor_neither_moves_nor_feels():
    bench = Hexapod(unit="rigid", instruments="all", noise=False)
    u = np.zeros((8, 400))
    u[6] = 10.0
    assert not bench.run(u).outputs.any()
    u[:] = 5.0
    y = bench.run(u).outputs
    assert not y[6:9].any()
    assert np.abs(y[9:]).max() > 0.0
    noisy = Hexapod(unit="rigid", instruments="all", quantise=False).run(np.zeros((8, 4000))).outputs
    assert noisy[6:9].std(axis=1) == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("held", [True, False])
def test_free_struts_behave_as_without_instruments(held, seed):
    """Held fast, the proof masses are part of the bodies: the struts cannot tell."""
    from dataclasses import replace

    from ultraquiet.bench.hexapod.chain import sampled_response
    from ultraquiet.bench.hexapod.physics.assemble import assemble

    parts = Hexapod(unit="flight", instruments="all").model.parts
    if held:
        parts = replace(parts, proof_masses=tuple(replace(p, suspension_hz=3e5) for p in parts.proof_masses))
    bare = Hexapod(unit="flight").linear_response(WIDE) * np.exp(2j * np.pi * WIDE / RATE)
    every = sampled_response(assemble(parts), parts, WIDE)[:6, :6]
    off = np.abs(every - bare).max(axis=(0, 1)) / np.linalg.norm(bare, axis=(0, 1))
    print(f"struts differ by {off.max():.1e} of |G| with proof masses {'held fast' if held else 'free'}")
    assert off.max() < 1e-3 if held else 1e-3 < off.max() < 0.1


def test_a_floating_hexapod_keeps_its_momentum():
    """Nothing from outside acts: total momentum stays zero whatever strut or proof mass pushes."""
    model = Hexapod(unit="flight", instruments="all").model
    m = model.mechanics
    # A rigid motion of all: base and payload turn and shift together, the struts' masses follow their stacks.
    parts = model.parts
    lift = np.zeros((len(m.M), 3))
    lift[:3], lift[6:9] = np.eye(3), np.eye(3)
    lift[12:18] = parts.at.directions
    assert np.abs(m.stiffness(m.stages.glass_n_per_m) @ lift).max() < 1e-6
    assert np.abs(lift.T @ m.push).max() < 1e-12
    # Moved as one, the proof masses ride along in the bodies' mass; the struts' masses move along their struts only.
    assert parts.base.body is not None
    along = np.sum(parts.per_strut("moving_mass_kg") * parts.at.directions[:, 2] ** 2)
    momentum = lift[:, 2] @ m.M @ lift[:, 2]
    assert momentum == pytest.approx(parts.base.body.mass_kg + PAYLOAD.mass_kg + along)


def test_the_proof_mass_pushes_with_2_n_above_its_suspension():
    """On the rigid floor, above the suspension, the payload is a free mass: velocity = F / (m w) along z, with 10 V."""
    bench = Hexapod(unit="rigid", instruments="all")
    p, line = bench.model.parts.proof_masses[1], bench.model.parts.lines[-1]
    f_hz = np.array([700.0, 900.0])
    w = 2 * np.pi * f_hz
    v = bench.model.mechanics.displacement(f_hz)[9:12, 7] * w  # per volt, modulus of the speed
    up = np.abs(triaxial_axes().T @ v)[2]
    force = up * PAYLOAD.mass_kg * w * 10.0
    print(f"force at full command: {force} N; geophone {line.geophone_v_per_m_s * line.gain:g} V/(m/s)")
    # Off its axis it turns the payload as well, and the struts' masses ride along by a little.
    assert force == pytest.approx(10.0 * p.newton_per_v, rel=0.1)
    assert 10.0 * p.newton_per_v == 2.0


def test_the_geophones_are_tilted_by_5_degrees():
    axes = triaxial_axes()
    assert np.degrees(np.arccos(axes[2, 2])) == pytest.approx(TILT_DEG) == pytest.approx(5.0)
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-15)


def test_a_base_disturbance_is_isolated_above_the_suspension():
    """Base to payload transmissibility, vertical: about one far below the modes, small far above."""
    bench = Hexapod(unit="ground", instruments="all")
    g = bench.linear_response(np.array([8.0, 300.0]))
    base, payload = (np.abs(g[rows, 6]) for rows in (8, 11))
    t = payload / base
    print(f"transmissibility {t[0]:.2f} at 8 Hz, {t[1]:.3f} at 300 Hz")
    assert 0.7 < t[0] < 1.5
    assert t[1] < 0.1


@pytest.mark.parametrize(("ny", "nu"), [(6, 6), (12, 8)])
@pytest.mark.parametrize("hysteresis", [False, True])
def test_laws_of_the_struts_and_of_all_channels_run(ny, nu, hysteresis, rng, seed):
    law = law_of(rng, ny, nu)
    u = 3.0 * rng.normal(size=(8, 500))
    bench = Hexapod(instruments="all", seed=seed, hysteresis=hysteresis)
    fast = bench.run(u, controller=law, run_index=0)
    slow = bench.run(u, controller=SteppedController(law), run_index=0)
    assert np.abs(fast.outputs - slow.outputs).max() < 1e-9
    assert np.abs(fast.inputs - slow.inputs).max() < 1e-9
    twin = SteppedController(law)
    answers = np.array([twin.step(y) for y in fast.outputs[:ny].T]).T
    formed = u + np.pad(answers, ((0, 8 - nu), (0, 0)))
    limits = np.array([[c.high] for c in bench.actuators])
    assert fast.inputs == pytest.approx(np.clip(formed, -limits, limits), abs=1e-9)


@pytest.mark.parametrize("unit", UNITS)
def test_a_chirp_of_25_v_stays_in_the_range_of_the_geophones_on_the_bodies(unit):
    bench = Hexapod(unit=unit, instruments="all", noise=False)
    chirp = signals.Chirp(start_hz=5.0, stop_hz=100.0, start_v=25.0, stop_v=5.0).generate(7000, RATE)
    u = np.zeros((8, 7000))
    u[1] = chirp
    peak = np.abs(bench.run(u).outputs).max(axis=1)
    print(f"{unit}: strut 2 {peak[1]:.1f} V, base {peak[6:9].max():.2f} V, payload {peak[9:].max():.2f} V")
    assert peak[6:].max() < 10.0


def test_plays_act_on_stacks_only(rng):
    u = np.zeros((8, 2000))
    u[7] = 8.0 * np.sin(2 * np.pi * 40.0 * np.arange(2000) / RATE)
    quiet = {"instruments": "all", "noise": False, "quantise": False}
    with_plays, without = Hexapod(hysteresis=True, **quiet).run(u), Hexapod(**quiet).run(u)
    assert np.array_equal(with_plays.outputs, without.outputs)


def test_the_noise_of_the_struts_does_not_depend_on_the_other_instruments(seed):
    few = Hexapod(seed=seed).run(np.zeros((6, 300)))
    all_of_them = Hexapod(seed=seed, instruments="all").run(np.zeros((8, 300)))
    assert np.array_equal(few.outputs, all_of_them.outputs[:6])
    assert np.abs(np.corrcoef(all_of_them.outputs) - np.eye(12)).max() < 7 / np.sqrt(300)


@pytest.mark.parametrize(("ny", "nu"), [(6, 8), (12, 6), (5, 5)])
def test_other_sizes_are_refused(ny, nu, rng):
    with pytest.raises(InputError, match="must take 12 readings and give 8 commands"):
        Hexapod(instruments="all").run(np.zeros((8, 10)), controller=law_of(rng, ny, nu))
    with pytest.raises(InputError, match=r"shape \(8, samples\)"):
        Hexapod(instruments="all").run(np.zeros((6, 10)))


class Counting:
    """Says nothing of its size, so it gets everything."""

    def reset(self):
        self.seen = set()

    def step(self, y):
        self.seen.add(y.size)
        return np.zeros(8)


def test_a_stepped_controller_of_unknown_size_gets_all_channels():
    law = Counting()
    Hexapod(instruments="all").run(np.zeros((8, 5)), controller=law)
    assert law.seen == {12}


def test_limits_of_proof_masses_are_met_and_counted():
    u, d = np.zeros((8, 30)), np.zeros((8, 30))
    u[6, 3:5] = 12.0
    d[7, 9] = -11.0
    told = Hexapod(instruments="all", noise=False).run(u, d).provenance.settings
    assert told["limited_commands"] == [0] * 6 + [2, 0]
    assert told["limited_proof_masses"] == [0, 1]
    assert told["limited_stacks"] == [0] * 6
