"""One command's proof: host, targets, loop and bench, and what is said when something is missing."""

import json
import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from deploy_laws import RATE_HZ

import ultraquiet as uq
from ultraquiet._base.errors import InputError, ToolError
from ultraquiet.deploy import generate, on_bench, reanalysis
from ultraquiet.deploy.c_code import render
from ultraquiet.deploy.c_code.footprint import footprint_on, stack_bytes, state_bytes
from ultraquiet.deploy.toolchain.emulator import build
from ultraquiet.deploy.toolchain.targets import TARGETS, missing_program
from ultraquiet.deploy.verification.fuzz import fuzz_code
from ultraquiet.simulate import attenuation
from ultraquiet.values import StateSpace, SteppedController
from ultraquiet.values.interconnect import sensitivity

LIBRARY_BYTES = 16  # the routine that clears memory, which the call graph does not hold

pytestmark = pytest.mark.usefixtures("cc")


@pytest.fixture
def target():
    absent = missing_program()
    if absent is not None:
        pytest.skip(f"'{absent}' is not installed (Debian: gcc-arm-none-eabi, qemu-system-arm)")


@pytest.fixture(scope="module")
def loop():
    """The bench's linear model and a law for it."""
    plant = uq.bench.Hexapod(unit="ground").linear_model()
    law = uq.design.Lqg(band_hz=(9.0, 108.0), control_weight=1e-8).design(plant).controller
    assert law is not None
    return plant, law


@pytest.mark.slow
@pytest.mark.usefixtures("target")
def test_the_whole_proof(loop, seed, tmp_path):
    plant, law = loop
    made = generate(law, tmp_path / "code", plant=plant)
    bench = uq.bench.Hexapod(unit="ground", seed=seed)
    found = made.verify(steps=5000, seed=seed, bench=bench)
    print(found.status, *found.targets, sep="\n")
    print(*found.loop.rows(), sep="\n")
    assert found.ok
    assert [each.target.name for each in found.targets] == list(TARGETS)
    assert all(each.bit_exact and each.steps == 5000 for each in found.targets)
    assert not found.missing
    assert found.loop.ok
    assert np.abs(found.loop.loss_db).max() < 0.1
    print(f"reduction {found.bench.worst_code_db} dB, lost {found.bench.loss_db} dB")
    assert found.bench.loss_db.max() < 0.5
    tables = json.loads((tmp_path / "code" / "manifest.json").read_text())["tables"]
    assert tables == made.tables
    assert tables["bit_exact_on"] == dict.fromkeys(TARGETS, True)
    assert tables["cortex_m4f_instructions"] == found.on("cortex-m4f").step
    latency = found.cortex_m7.output / 216e6
    assert tables["latency_us"]["cortex-m7"] == pytest.approx(1e6 * latency)
    assert latency < 0.5 / RATE_HZ


@pytest.mark.slow
def test_on_bench_measures_what_simulate_measures(loop, seed, tmp_path):
    _, law = loop
    bench = uq.bench.Hexapod(unit="ground", seed=seed)
    found = on_bench(bench, law, generate(law, tmp_path / "code").controller, tones_hz=(25.0,))
    code = generate(law, tmp_path / "b").controller
    fresh = on_bench(lambda: uq.bench.Hexapod(unit="ground", seed=seed), law, code, tones_hz=(5.0, 25.0, 100.0))
    assert found.same_noise
    assert np.array_equal(found.code_db[0], fresh.code_db[1])
    other = attenuation(uq.bench.Hexapod(unit="ground", seed=seed), law, tones_hz=(25.0,))
    print(found.worst_law_db, other.worst_reduction_db, "dB; the other measurement has a noise of its own")
    assert found.worst_law_db == pytest.approx(other.worst_reduction_db, abs=0.3)


@pytest.mark.slow
def test_on_bench_refuses_what_cannot_be_measured(loop, tmp_path):
    _, law = loop
    code, bench = generate(law, tmp_path / "code").controller, uq.bench.Hexapod()
    for settings in ({"tones_hz": ()}, {"tones_hz": (0.1,)}, {"amplitude_v": 0.0}, {"duration_s": -1.0}):
        with pytest.raises(InputError, match="on_bench"):
            on_bench(bench, law, code, **settings)


@pytest.mark.parametrize(("ny", "nu", "unit"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
@pytest.mark.parametrize("rate_hz", [0.01, 2.0, 4.0, 1000.0])
def test_tones_that_nobody_asked_for_are_below_nyquist_and_told_at_every_rate(ny, nu, unit, rate_hz):
    B, D = 0.1 * unit * np.eye(ny, nu), np.zeros((ny, nu))
    plant = StateSpace(0.9 * np.eye(ny), B, np.eye(ny), D, rate_hz)
    n = min(ny, nu)
    law = StateSpace(0.1 * np.eye(n), 0.1 * np.eye(n, ny), np.eye(nu, n) / unit, -0.3 / unit * np.eye(nu, ny), rate_hz)
    found = on_bench(uq.bench.LinearBench(plant), law, SteppedController(law))
    assert 0 < min(found.tones_hz) < max(found.tones_hz) < rate_hz / 2
    assert found.status.ok
    reached = slice(0, n)
    S = np.abs(sensitivity(plant, law).frequency_response(found.tones_hz))
    wanted = -20 * np.log10(np.array([np.diagonal(each)[reached] for each in np.moveaxis(S, 2, 0)]))
    assert found.law_db[:, reached] == pytest.approx(wanted, abs=0.3)
    bench, code = uq.bench.LinearBench(plant), SteppedController(law)
    with pytest.raises(InputError, match="holds no tone below Nyquist's"):
        on_bench(bench, law, code, duration_s=8 / rate_hz)
    with pytest.raises(InputError, match="'tones_hz' must lie below Nyquist's"):
        on_bench(bench, law, code, tones_hz=(rate_hz / 2,))


class Noisy:
    """A bench whose readings carry noise of their own in every run, of a size beside the tones'."""

    def __init__(self, plant, size, rng):
        self.bench, self.size, self.rng = uq.bench.LinearBench(plant), size, rng
        self.rate_hz, self.actuators = self.bench.rate_hz, self.bench.actuators

    def run(self, *signals, **settings):
        record = self.bench.run(*signals, **settings)
        noise = self.rng.standard_normal(record.outputs.shape)
        return replace(record, outputs=record.outputs + self.size * noise)


@pytest.mark.parametrize(("ny", "nu", "unit"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_what_noise_may_feign_is_no_loss_of_the_code(ny, nu, unit, seed):
    """Law and code are the same: no noise makes the code degraded; half of the gain is seen through a little of it."""
    plant = StateSpace(0.9 * np.eye(ny), 0.1 * unit * np.eye(ny, nu), np.eye(ny), np.zeros((ny, nu)), 1000.0)
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), -2 / unit * np.eye(nu, ny), 1000.0)
    half = StateSpace(law.A, law.B, law.C, law.D / 2, 1000.0)
    rng, words = np.random.default_rng(seed), []
    for size in np.geomspace(1e-3, 30, 40):
        made = Noisy(plant, unit * size, rng)
        same = on_bench(lambda made=made: made, law, SteppedController(law), tones_hz=(5.0, 40.0), duration_s=0.5)
        words.append(str(same.status.word))
    print(words)
    assert set(words) == {"ok", "not measured"}
    assert words[0] == "ok"
    assert words[-1] == "not measured"
    made = Noisy(plant, 1e-2 * unit, rng)
    found = on_bench(lambda: made, law, SteppedController(half), tones_hz=(5.0, 40.0), duration_s=0.5)
    print(found.status, found.noise_db)
    assert found.status.word == "degraded"


def test_a_rounded_loop_is_told_at_no_tone_beyond_nyquist():
    plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], 1000.0)
    law = StateSpace([[0.1]], [[0.1]], [[1.0]], [[-0.3]], 1000.0)
    assert reanalysis(law, law, plant, (5.0, 500.0)).status.ok
    with pytest.raises(InputError, match="900 Hz lie beyond Nyquist's 500 Hz"):
        reanalysis(law, law, plant, (5.0, 900.0))


@pytest.mark.slow
def test_a_law_that_loses_attenuation_is_degraded(loop, seed, tmp_path):
    """A law of half the gain attenuates less: both judges must say so."""
    plant, law = loop
    half = StateSpace(law.A, law.B, 0.5 * law.C, 0.5 * law.D, rate_hz=law.rate_hz)
    judged = reanalysis(law, half, plant)
    print(judged.status)
    assert judged.status.word == "degraded"
    bench = uq.bench.Hexapod(unit="ground", seed=seed)
    measured = on_bench(bench, law, generate(half, tmp_path / "code").controller)
    print(measured.status)
    assert measured.status.word == "degraded"


@pytest.mark.slow
def test_rounding_that_upsets_the_loop_is_said(loop):
    plant, law = loop
    wrong = StateSpace(law.A, law.B, -3.0 * law.C, -3.0 * law.D, rate_hz=law.rate_hz)
    judged = reanalysis(law, wrong, plant)
    print(judged.status)
    assert judged.status.word == "unstable"
    assert "stable as designed, not with the rounded law" in judged.status.sentence
    assert "already as designed" in reanalysis(wrong, law, plant).status.sentence


@pytest.mark.slow
def test_a_loop_unstable_by_design_says_nothing_against_the_code(loop, seed, tmp_path):
    plant, law = loop
    wrong = StateSpace(law.A, law.B, -3.0 * law.C, -3.0 * law.D, rate_hz=law.rate_hz)
    found = generate(wrong, tmp_path / "code").verify(500, seed, plant=plant, targets=())
    print(found.status)
    assert found.ok
    assert "unstable already as designed" in found.status.sentence


def test_missing_cross_tools_are_named_and_the_rest_is_done(law_of, seed, tmp_path, monkeypatch):
    made = generate(law_of(4), tmp_path / "code", ramp_s=0.01)
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("cc", "gcc", "as", "ld", "collect2"):
        found = shutil.which(name)
        if found:
            (tools / name).symlink_to(found)
    monkeypatch.setenv("PATH", str(tools))
    monkeypatch.delenv("CC", raising=False)
    proof = made.verify(steps=500, seed=seed)
    print(proof.status)
    assert proof.ok
    assert proof.targets == ()
    titles = " and ".join(target.title for target in TARGETS.values())
    assert proof.missing == (f"'arm-none-eabi-gcc' is not installed, so nothing was run or counted on {titles}.",)
    assert proof.missing[0] in (tmp_path / "code" / "README.md").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("target")
def test_a_difference_on_one_target_alone_is_found(law_of, seed, tmp_path):
    made = generate(law_of(6), tmp_path / "code", ramp_s=0.01)
    path = tmp_path / "code" / "controller_cortex.c"
    told = "reply.output = since(then);"
    text = path.read_text()
    assert told in text
    path.write_text(text.replace(told, f"{told}\n if (s.steps == 300U) {{ reply.u[0] = (controller_real)12345; }}"))
    found = made.verify(500, seed)
    print(found.status)
    assert found.mismatches == 0
    assert found.self_test is True
    assert found.bit_exact is False
    assert not found.ok
    assert "1 commands of 500 steps differ on the Cortex-M4F" in found.status.sentence


@pytest.mark.usefixtures("target")
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_struct_size_without_a_compiler_is_the_compilers(law_of, rng, tmp_path, precision):
    law = law_of(int(rng.integers(1, 30)), int(rng.integers(1, 8)), int(rng.integers(1, 8)))
    made = generate(law, tmp_path / "code", precision, anti_windup=bool(rng.integers(2)))
    size = state_bytes((tmp_path / "code" / "controller.h").read_text(), "controller")
    source = tmp_path / "code" / "size.c"
    source.write_text('#include "controller.h"\nconst char size[sizeof(controller_state)] = {1};\n')
    subprocess.run(
        [TARGETS["cortex-m7"].family.compiler, "-mcpu=cortex-m7", "-c", source, "-o", tmp_path / "size.o"], check=True
    )
    told = subprocess.run(
        ["arm-none-eabi-nm", "-S", tmp_path / "size.o"], capture_output=True, text=True, check=True
    ).stdout
    assert size == int(told.split()[1], 16) == made.tables["ram_bytes"]


def test_unknown_members_have_no_size():
    assert state_bytes("struct c_state { wide_t x[3]; };", "c") is None
    assert state_bytes("struct other { int x; };", "c") is None


@pytest.mark.gate("cortex-m4f")
@pytest.mark.usefixtures("target")
@pytest.mark.parametrize("name", TARGETS)
def test_stack_bound_holds_what_a_step_really_uses(law_of, rng, tmp_path, name):
    """Paint the memory below the stack pointer, run a step, look how deep it went."""
    made = generate(law_of(int(rng.integers(2, 40))), tmp_path / "code")
    bound = footprint_on(made.law, made.folder, TARGETS[name]).stack_bytes
    used = painted(made.law, made.folder, TARGETS[name])
    print(f"{name}: {used} bytes of stack used, bound {bound}")
    assert bound is not None
    assert 0 < used <= bound + LIBRARY_BYTES


def painted(law, folder, target) -> int:
    """Return the deepest byte that output and update touched below their caller's frame."""

    path = folder / "controller_cortex.c"
    text = path.read_text()
    at = text.index("void reset(void)\n{")
    paint = """
    __attribute__((noinline)) static uint32_t depth(void)
    {
        volatile unsigned char *top = __builtin_frame_address(0);
        volatile unsigned char *at = top - 4096;
        while (at < top) { *at++ = 0xA5U; }
        frame.ask = ASK_ENGAGE;
        answer();
        at = top - 3000;
        while (at < top) { *at++ = 0xA5U; }
        controller_output(&s, frame.y, reply.u);
        controller_update(&s);
        at = top - 3000;
        while (*at == 0xA5U) { at++; }
        return (uint32_t)(top - at);
    }
    """
    path.write_text(
        text[:at]
        + paint
        + text[at:].replace("if (serve() == 0U) {", 'say("depth ", depth());\n    if (serve() == 0U) {')
    )
    program = build(law, folder, folder, target)
    told = subprocess.run(
        [str(part) for part in target.command(program)], cwd=folder, capture_output=True, text=True, check=False
    )
    found = re.search(r"depth (\d+)", told.stdout + told.stderr)
    assert found, told
    return int(found[1])


def test_call_graph_follows_the_deepest_chain():
    def node(name, size):
        return rf'node: {{ title: "{name}" label: "{name}\nc.c:1:1\n{size} bytes (static)" }}'

    edge = 'edge: {{ sourcename: "{}" targetname: "{}" }}'.format
    graph = "\n".join([node("c_output", 10), node("c.c:law", 7), node("c.c:deep", 30), node("c_update", 20)])
    calls = "\n".join([edge("c_output", "c.c:law"), edge("c.c:law", "c.c:deep"), edge("c_update", "memset")])
    assert stack_bytes(graph, "c") == 20
    assert stack_bytes(graph + calls, "c") == 47
    assert stack_bytes(graph + calls + edge("c.c:deep", "c.c:law"), "c") is None
    assert stack_bytes(graph.replace("30 bytes (static)", "30 bytes (dynamic)"), "c") is None
    assert stack_bytes("", "c") is None


def test_unknown_target_is_refused_before_work(law_of, tmp_path):
    made = generate(law_of(2), tmp_path / "code", ramp_s=0.01)
    with pytest.raises(InputError, match="'target' must be one of"):
        made.verify(100, targets=("avr",))


@pytest.mark.slow
def test_command_prints_one_table(loop, tmp_path, monkeypatch, capsys):
    plant, law = loop
    uq.files.save(law, tmp_path / "law.h5")
    uq.files.save(plant, tmp_path / "plant.h5")
    words = ["deploy", "law.h5", "--plant", "plant.h5", "--steps", "300", "--form", "delta", "--target", "cortex-m7"]
    code, said = command(monkeypatch, capsys, tmp_path, *words)
    print(said)
    assert code == 0
    for line in (
        "delta",
        "compared here",
        "loop: phase margin",
        "attenuation of the worst direction at ",
        "ok: All bits of 300 steps",
    ):
        assert line in said
    assert ("on Cortex-M7" in said) == (missing_program() is None)
    assert "on Cortex-M4F" not in said


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--target", "z80"], "'target' must be one of"),
        (["--steps", "0"], "'steps' must be between 1 and 10000000"),
        (["--budget", "300"], "largest order that would fit"),
        (["--form", "companion"], "'form' must be one of"),
        (["--precision", "float16"], "must be one of"),
    ],
)
def test_command_refuses_in_a_sentence_and_leaves_nothing(loop, tmp_path, monkeypatch, capsys, words, sentence):
    uq.files.save(loop[1], tmp_path / "law.h5")
    code, said = command(monkeypatch, capsys, tmp_path, "deploy", "law.h5", *words)
    print(said)
    assert code == 2
    assert sentence in " ".join(said.split())
    assert os.listdir(tmp_path) == ["law.h5"]


def command(monkeypatch, capsys, folder: Path, *words):
    from ultraquiet.cli.app import main

    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr("sys.argv", ["ultraquiet", *words])
    capsys.readouterr()
    code = 0
    try:
        main()
    except SystemExit as stop:
        code = stop.code or 0
    said = capsys.readouterr()
    return code, said.out + said.err


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_random_bits_find_nothing_in_the_code_and_a_missing_limit_at_once(law_of, seed, tmp_path, cc, precision):
    made = generate(law_of(6), tmp_path / "code", precision, limits_v=[[-3.0, 2.0]] * 6, ramp_s=0.01)
    clean = fuzzed(made, cc, seed, 20_000)
    assert clean.finding == ""
    path = tmp_path / "code" / "controller.h"
    header = tmp_path / "code" / "controller_coefficients.h"
    low = render.constant(made.law.limits[0, 0], precision)
    changed = 0
    for file in (path, header):
        text = file.read_text()
        changed += text.count(low)
        file.write_text(text.replace(low, render.constant(4 * made.law.limits[0, 0], precision)))
    assert changed
    broken = fuzzed(made, cc, seed, 20_000)
    print(broken.finding)
    assert re.match(r"command \d is -\d", broken.finding)
    found = made.verify(100, seed, targets=())
    assert found.status.word in ("differs", "self-test failed", "unsafe")


@pytest.mark.slow
def test_random_bits_meet_an_index_beyond_its_array(law_of, seed, tmp_path, cc):
    made = generate(law_of(6), tmp_path / "code", ramp_s=0.01)
    path = tmp_path / "code" / "controller.c"
    text = path.read_text()
    start = re.search(r"void controller_output\([^)]*\)\s*\{", text)
    assert start
    path.write_text(
        text[: start.end()] + "\n    u[CONTROLLER_OUTPUTS + s->faults] = (controller_real)0;\n" + text[start.end() :]
    )
    broken = fuzzed(made, cc, seed, 1000)
    print(broken.finding)
    assert re.search("AddressSanitizer|runtime error", broken.finding)


def fuzzed(made, cc, seed, steps):
    try:
        return fuzz_code(made, cc, steps, seed)
    except ToolError as refusal:
        if "no working sanitizers" not in str(refusal):
            raise
        pytest.skip(str(refusal))
