"""On emulated Cortex-M4F and M7: the same bits as here, and instructions counted exactly."""

import json
import os

import numpy as np
import pytest

from ultraquiet._base.errors import ToolError
from ultraquiet.deploy import generate
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.deploy.toolchain.compiler import compile_c
from ultraquiet.deploy.toolchain.cortex_m.processors import CORTEX_M
from ultraquiet.deploy.toolchain.emulator import count_instructions, run_on_target
from ultraquiet.deploy.toolchain.targets import TARGETS, missing_program
from ultraquiet.deploy.verification.verify import compare, measurements


@pytest.fixture
def target():
    absent = missing_program()
    if absent is not None:
        pytest.skip(f"'{absent}' is not installed (Debian: gcc-arm-none-eabi, qemu-system-arm)")


@pytest.mark.gate("modal-float32")
@pytest.mark.usefixtures("target")
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("form", ["modal", "delta", "schur", "dense"])
def test_self_test_passes_bit_for_bit_on_the_target(law_of, rng, tmp_path, form, precision):
    law = law_of(int(rng.integers(2, 30)), int(rng.integers(1, 8)), int(rng.integers(1, 8)))
    made = generate(law, tmp_path / "code", precision, form=form, anti_windup=bool(rng.integers(2)), ramp_s=0.01)
    counts = {name: count_instructions(made.law, made.folder, each) for name, each in TARGETS.items()}
    assert all(count.self_test for count in counts.values()), counts


@pytest.mark.slow
@pytest.mark.usefixtures("target")
@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize(("precision", "steps"), [("float32", 20_000), ("float64", 4_000)])
def test_long_run_bit_for_bit_on_the_target(law_of, seed, tmp_path, name, precision, steps):
    """Ramps, limits and a NaN included; the instructions of every step are known, those inside the limits are equal."""
    made = generate(law_of(30), tmp_path / "code", precision, ramp_s=0.1)
    y = measurements(made.plan, steps, seed)
    twin = Twin(made.law)
    twin.enable()
    run = run_on_target(made.law, made.folder, y, TARGETS[name])
    assert compare(run.u, twin.run(y)) == (0, None)
    calm = slice(400, 2200)  # after the ramp, before the first burst
    print(f"{name} {precision}: {np.unique(run.step[calm])} instructions a step, {np.unique(run.step)} in all modes")
    if precision == "float32" or name == "cortex-m7":  # the M4F has no double-precision unit: a library adds
        assert np.ptp(run.step[calm]) == 0


@pytest.mark.usefixtures("target")
def test_self_test_counts_what_a_run_counts(law_of, seed, tmp_path):
    made = generate(law_of(20), tmp_path / "code", form="modal", ramp_s=0.01)
    y = 1e-3 * np.random.default_rng(seed).standard_normal((6, 100))
    run = run_on_target(made.law, made.folder, y, ramp=False)
    assert count_instructions(made.law, made.folder).step == run.step.max()


@pytest.mark.usefixtures("target")
def test_target_that_ends_early_is_a_sentence(law_of, tmp_path):
    made = generate(law_of(4), tmp_path / "code", ramp_s=0.01)
    path = tmp_path / "code" / "controller_cortex.c"
    asked = "if (frame.ask == ASK_STEP) {"
    path.write_text(path.read_text().replace(asked, "if (s.steps == 7U) { return 0; }\n" + asked))
    with pytest.raises(ToolError, match="refused the generated code"):
        run_on_target(made.law, made.folder, np.zeros((6, 10)))
    path.write_text(path.read_text().replace("return 0;", "(void)semihost(SEMIHOST_EXIT, (const void *)STOPPED);"))
    with pytest.raises(ToolError, match=r"emulated Cortex-M7 ended after \d+ of 10 steps"):
        run_on_target(made.law, made.folder, np.zeros((6, 10)))


@pytest.mark.usefixtures("target")
def test_target_notices_a_wrong_bit(law_of, tmp_path):
    made = generate(law_of(6), tmp_path / "code", ramp_s=0.01)
    path = tmp_path / "code" / "controller.c"
    text = path.read_text()
    assert "(level > 0U)" in text
    path.write_text(text.replace("(level > 0U)", "(level > 1U)"))
    assert not count_instructions(made.law, made.folder).self_test


@pytest.mark.slow
@pytest.mark.usefixtures("target")
def test_instructions_grow_with_the_floor_of_the_form(law_of, tmp_path):
    """Modal form needs 14 multiply-adds a state (load, multiply, add each, so 42) and some counting."""
    counts = {}
    for states in (30, 60, 120):
        made = generate(law_of(states), tmp_path / str(states), form="modal", ramp_s=0.01)
        counts[states] = count_instructions(made.law, made.folder)
    slopes = [(counts[b].step - counts[a].step) / (b - a) for a, b in ((30, 60), (60, 120))]
    print({n: (c.step, c.output) for n, c in counts.items()}, f"{slopes} instructions a state")
    assert np.ptp(slopes) < 1.0
    assert min(slopes) >= 14
    assert max(slopes) < 1.25 * 42
    # A Cortex-M7 at 216 MHz that needed two cycles an instruction would still spend less than half a frame.
    assert 2 * counts[120].step / 216e6 < 0.5 / 3500


@pytest.mark.usefixtures("target")
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_ram_is_the_state_on_the_target(law_of, rng, tmp_path, precision):
    law = law_of(int(rng.integers(1, 30)), int(rng.integers(1, 8)), int(rng.integers(1, 8)))
    made = generate(law, tmp_path / "code", precision)
    size = f"char same[sizeof(controller_state) == {made.tables['ram_bytes']}U ? 1 : -1];"
    (tmp_path / "code" / "size.c").write_text(f'#include "controller.h"\n{size}\n')
    target = TARGETS["cortex-m7"]
    compile_c([target.family.compiler, *target.flags, "-c", "size.c"], tmp_path / "code")
    assert made.tables["flash_from"].startswith("arm-none-eabi-gcc")


@pytest.mark.slow
@pytest.mark.usefixtures("target", "cc")
def test_verification_fills_the_table(law_of, tmp_path):
    made = generate(law_of(10), tmp_path / "code", ramp_s=0.01)
    assert made.tables["cortex_m7_instructions"] is None
    found = made.verify(steps=500)
    print(found.status)
    assert found.cortex_m7 is not None
    assert made.tables["cortex_m7_instructions"] == found.cortex_m7.step > 0
    held = json.loads((tmp_path / "code" / "manifest.json").read_text())
    assert held["tables"] == made.tables
    assert held["verified"].startswith("ok: All bits")
    assert "emulated Cortex-M7" in (tmp_path / "code" / "README.md").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("target", "cc")
def test_emulator_out_of_order_does_not_spoil_the_comparison(law_of, tmp_path, monkeypatch):
    made = generate(law_of(4), tmp_path / "code", ramp_s=0.01)
    tools = tmp_path / "tools"
    tools.mkdir()
    (tools / CORTEX_M.emulator).write_text("#!/bin/sh\necho no such machine >&2; exit 1\n")
    (tools / CORTEX_M.emulator).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tools}{os.pathsep}{os.environ['PATH']}")
    found = made.verify(steps=100)
    print(found.status)
    assert found.bit_exact is True
    assert found.cortex_m7 is None
    assert "make no sense: 'no such machine'" in found.status.sentence
    assert made.tables["cortex_m7_instructions"] is None


def test_missing_tools_are_named(law_of, tmp_path, monkeypatch):
    made = generate(law_of(2), tmp_path / "code", ramp_s=0.01)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ToolError, match="'arm-none-eabi-gcc' is not installed"):
        count_instructions(made.law, made.folder)


@pytest.mark.slow
@pytest.mark.skipif(missing_program() is not None, reason="no compiler or emulator for the target")
def test_small_code_against_fast_code_in_measured_instructions(law_of, tmp_path, monkeypatch):
    """The same bits at -Os and -O2; the counts of both are printed."""
    from ultraquiet.deploy.toolchain import emulator

    usual = emulator.FLAGS
    for states in (30, 60):
        made = generate(law_of(states), tmp_path / f"{states}", form="modal")
        for level in ("-O2", "-Os"):
            monkeypatch.setattr(emulator, "FLAGS", tuple(level if flag == "-O2" else flag for flag in usual))
            found = made.verify(300, targets=("cortex-m7",), fuzz_steps=0).on("cortex-m7")
            print(f"{states} states at {level}: {found}")
            assert "bit-exact" in str(found)
