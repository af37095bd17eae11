"""The emitted C31 assembly, run by an interpreter: its cycles are the model's, its bits those of the law's twin."""

import re
import shutil
import subprocess
from dataclasses import replace

import c31_numbers as num
import numpy as np
import pytest
from c31_interpreter import Machine
from c31_program import Program, RefusedError
from deploy_laws import random_law

from ultraquiet.deploy import generate
from ultraquiet.deploy.c31 import arithmetic
from ultraquiet.deploy.c31 import cycles as budget
from ultraquiet.deploy.c31.assembly import COUNTS_PER_VOLT, VOLTS_PER_COUNT, c31_code, converter_limits
from ultraquiet.deploy.c31.float_format import decode, encode
from ultraquiet.deploy.c31.twin import C31Twin
from ultraquiet.deploy.law.anti_windup import conditioning_gain
from ultraquiet.deploy.law.coefficients import anti_windup_gain
from ultraquiet.deploy.law.law import actuator_limits
from ultraquiet.deploy.law.realisation import Realisation
from ultraquiet.deploy.law.rounding import rounded

INTERRUPT = 4  # the vector's fetch empties the pipeline as a branch does
STEPS = 1000
# Half a unit of 24 bits is 6e-8; over 25 draws and 1000 steps rounding grew to 8e-7 of the largest command.
DIGITS = 5e-6


def law_in(rng, states, form="modal", anti_windup=False, inputs=6, outputs=6, limit_v=8.0):
    """Return a random law already in 2x2 blocks, rounded to float32, which the C31 holds exactly."""
    design = random_law(rng, states, inputs, outputs, mixed=False)
    pairs = [design.A[k : k + 2, k : k + 2] for k in range(0, states, 2)]
    blocks = tuple(p - np.eye(2) for p in pairs) if form == "delta" else tuple(pairs)
    parts = Realisation(form, blocks, design.B, design.C, design.D, 1.0)
    L = conditioning_gain(design.A, design.B, design.C, design.D) if anti_windup else None
    return rounded(parts, L, actuator_limits(limit_v, outputs), "float32", rate_hz=3500.0, order=states)


def bank_in(rng, channels, form="bank", anti_windup=False, limit_v=8.0):
    """Return a random decentralised law of `channels[c]` blocks each; a channel of none is a gain."""
    design, m = random_law(rng, 2 * sum(channels), mixed=False), len(channels)
    pairs = [design.A[k : k + 2, k : k + 2] for k in range(0, design.states, 2)]
    own = np.repeat(np.arange(m), 2 * np.array(channels))[:, None] == np.arange(m)
    blocks = tuple(p - np.eye(2) for p in pairs) if form == "bank-delta" else tuple(pairs)
    size = rng.standard_normal((2, *own.shape))
    parts = Realisation(form, blocks, size[0] * own, (size[1] * own).T, np.diag(rng.standard_normal(m)), 1.0, channels)
    L = anti_windup_gain(parts) if anti_windup else None
    return rounded(parts, L, actuator_limits(limit_v, m), "float32", rate_hz=3500.0, order=design.states)


def machine_of(law):
    code = c31_code(law)
    return Machine(Program(code.assembly, code.linker))


def feed(machine, counts):
    """Put signed integers into the converters."""
    for j, count in enumerate(counts):
        machine.memory[machine.program.symbols["ADC"] + j] = int(count) & 0xFFFFFFFF


def held(machine, name, count):
    at = machine.program.symbols[f"controller_{name}"]
    return decode([machine.memory[at + k] for k in range(count)])


def one_frame(law, rng):
    machine = machine_of(law)
    feed(machine, rng.integers(-(2**15), 2**15, law.inputs))
    machine.run("controller_frame")
    spent = {name.removeprefix("controller_"): cycles for name, cycles in machine.spent.items()}
    kernel = spent["output"] + spent["update"]
    return kernel, sum(spent.values()) - kernel + INTERRUPT, spent


def modelled(law):
    return budget.kernel_of(law)


def test_every_modal_order_from_2_to_120_takes_the_cycles_of_the_model(rng):
    for states in range(2, 121, 2):
        law = law_in(rng, states)
        kernel, rest, spent = one_frame(law, rng)
        assert kernel == modelled(law) == 15 * states + 101
        assert spent["output"] == budget.output_cycles(law)
        assert rest <= budget.SKELETON_CYCLES
    print(f"120 states: {kernel} kernel, {rest} of {budget.SKELETON_CYCLES} around it")


@pytest.mark.parametrize(("form", "anti_windup"), [("delta", False), ("modal", True), ("delta", True)])
def test_other_forms_take_the_cycles_of_the_model(form, anti_windup, rng):
    for states in (2, 4, 30, 60, 120):
        law = law_in(rng, states, form, anti_windup)
        kernel, rest, _ = one_frame(law, rng)
        print(f"{form}, anti-windup {anti_windup}, {states} states: {kernel} kernel, {rest} around it")
        assert kernel == modelled(law)
        assert rest <= budget.SKELETON_CYCLES


def test_other_sizes_take_the_cycles_of_the_model(rng):
    for inputs in range(1, 9):
        for outputs in range(1, 9):
            law = law_in(rng, 2 * int(rng.integers(1, 9)), "modal", bool(rng.integers(2)), inputs, outputs)
            kernel, rest, _ = one_frame(law, rng)
            assert kernel == modelled(law), (inputs, outputs)
            counted = budget.FRAME_WITH_CORRECTION + outputs if law.L is not None else budget.FRAME
            assert rest == counted + budget.READ * inputs + budget.WRITE * outputs <= budget.frame_cycles(law) - kernel


BANKS = [(5, 5, 5, 5, 5, 5), (1, 1, 1, 1, 1, 1), (4, 0, 2, 1, 0, 3), (2, 3, 0), (0, 4), (7,)]


@pytest.mark.parametrize("form", ["bank", "bank-delta"])
@pytest.mark.parametrize("anti_windup", [False, True])
def test_banks_take_the_cycles_of_the_model(form, anti_windup, rng):
    for channels in BANKS:
        law = bank_in(rng, channels, form, anti_windup)
        kernel, rest, spent = one_frame(law, rng)
        print(f"{form} {channels}, anti-windup {anti_windup}: {kernel} kernel, {rest} around it")
        assert kernel == modelled(law)
        assert spent["output"] == budget.output_cycles(law)
        assert rest <= budget.SKELETON_CYCLES


def test_60_states_within_1100_and_120_within_the_frame(rng):
    sixty, twice = one_frame(law_in(rng, 60), rng), one_frame(law_in(rng, 120), rng)
    print(f"60 states: {sixty[0]} kernel cycles; 120 states: {twice[0]} + {budget.SKELETON_CYCLES}")
    assert sixty[0] <= 1100
    assert twice[0] + budget.SKELETON_CYCLES <= 2800
    assert sum(twice[:2]) <= 2800


@pytest.mark.parametrize(
    ("form", "anti_windup", "steps"),
    [
        ("modal", True, STEPS // 5),
        *(pytest.param(f, a, STEPS, marks=pytest.mark.slow) for f in ("modal", "delta") for a in (False, True)),
    ],
)
def test_bits_are_those_of_the_twin(form, anti_windup, steps, rng):
    check_bits(law_in(rng, 8, form, anti_windup, limit_v=1.0), rng, steps)


@pytest.mark.gate("channels0-bank-False", "channels1-bank-delta-True")
@pytest.mark.parametrize(("form", "anti_windup"), [("bank", False), ("bank", True), ("bank-delta", True)])
@pytest.mark.parametrize("channels", [(1, 2, 1, 1, 1, 1), (2, 0, 1)])
def test_bits_of_a_bank_are_those_of_the_twin(form, anti_windup, channels, rng):
    check_bits(bank_in(rng, channels, form, anti_windup, limit_v=4.0), rng, STEPS // 5)


def check_bits(law, rng, steps):
    """Run text and twin side by side: every word that both have, after every frame."""
    machine, twin = machine_of(law), C31Twin(law, converter_limits(law), VOLTS_PER_COUNT, COUNTS_PER_VOLT)
    clipped, counts_per_step = 0, set()
    for _ in range(steps):
        counts = rng.integers(-(2**15), 2**15, law.inputs) // 2 ** int(rng.integers(12))
        feed(machine, counts)
        counts_per_step.add(machine.run("controller_frame"))
        codes = twin.frame(counts)
        y = arithmetic.stored(arithmetic.multiplied(counts.astype(float), decode(encode(VOLTS_PER_COUNT))))
        clipped += int((np.clip(twin.u, *law.limits.T.astype(float)) != twin.u).sum())
        assert np.array_equal(held(machine, "y", law.inputs), y)
        assert np.array_equal(held(machine, "u", law.outputs), twin.u)
        assert np.array_equal(held(machine, "x", law.states), twin.x)
        sent = [machine.memory[machine.program.symbols["DAC"] + i] for i in range(law.outputs)]
        assert np.array_equal(np.array(sent, dtype=np.uint32).view(np.int32), codes)
    commands = steps * law.outputs
    print(f"{law.form}: {steps} steps alike, {clipped} of {commands} commands limited, cycles {counts_per_step}")
    assert 0 < clipped < commands
    assert len(counts_per_step) == 1


@pytest.mark.gate("False-10.0", "True-25.0", "True-limit_v3")
@pytest.mark.parametrize("limit_v", [25.0, 10.0, 3.4e38, [-25.0, 4.0], [-10.0, 1e4]])
@pytest.mark.parametrize("anti_windup", [False, True])
def test_a_command_beyond_the_converter_stays_at_its_end(limit_v, anti_windup, rng):
    low_high = np.tile(limit_v, (6, 1)) if isinstance(limit_v, list) else limit_v
    check_codes(louder(law_in(rng, 8, "modal", anti_windup, limit_v=low_high)), rng)
    check_codes(louder(bank_in(rng, (2, 0, 1, 1, 1, 1), "bank", anti_windup, limit_v=low_high)), rng)


def louder(law):
    """Return the law with 32 times its commands: a power of two, so every coefficient stays one of the C31's."""
    L = None if law.L is None else law.L / np.float32(32)
    return replace(law, C=law.C * np.float32(32), D=law.D * np.float32(32), L=L)


def check_codes(law, rng):
    """Read the converters as 16 bits, which is all they have, and compare with the command held within both ranges."""
    full_v, count_v = 10.0, 10.0 / 2**15
    low, high = np.clip(law.limits.astype(float), -full_v, full_v).T
    machine, beyond = machine_of(law), 0
    for _ in range(100):
        feed(machine, rng.integers(-(2**15), 2**15, law.inputs) // 2 ** int(rng.integers(12)))
        machine.run("controller_frame")
        raw = held(machine, "u", law.outputs)
        sent = [machine.memory[machine.program.symbols["DAC"] + i] for i in range(law.outputs)]
        seen_v = np.array(sent, dtype=np.uint32).astype(np.uint16).view(np.int16) * count_v
        assert np.abs(seen_v - np.clip(raw, low, high)).max() <= 1.01 * count_v, (raw, seen_v)
        beyond += int((np.abs(raw) > full_v).sum())
    print(f"{law.form}, limits {low[0]:g} to {high[0]:g} V: {beyond} commands beyond the converter")
    assert beyond


def test_a_state_that_grows_beyond_all_numbers_sends_no_other_code(rng):
    """The C31 knows neither NaN nor infinity: sums stay at the largest number, and the code at the converter's end."""
    law = law_in(rng, 2, inputs=1, outputs=1, limit_v=25.0)
    block = np.diag([1e4, 1e4]).astype(np.float32)
    gains = {"B": np.ones_like(law.B), "C": np.ones_like(law.C), "D": np.zeros_like(law.D)}
    machine = machine_of(replace(law, blocks=(block,), **gains))
    feed(machine, [1000])
    codes = []
    for _ in range(40):
        machine.run("controller_frame")
        codes.append(machine.memory[machine.program.symbols["DAC"]])
    assert held(machine, "u", 1)[0] > 1e38
    assert set(codes[2:]) == {2**15 - 1}


@pytest.mark.slow
@pytest.mark.parametrize("form", ["modal", "delta"])
def test_commands_are_those_of_float64_within_the_c31s_digits(form, rng):
    law = law_in(rng, 16, form, limit_v=1e3)
    machine, exact = machine_of(law), law.state_space()
    x, error, size = np.zeros(law.states), 0.0, 0.0
    for _ in range(STEPS):
        feed(machine, rng.integers(-(2**15), 2**15, law.inputs))
        machine.run("controller_frame")
        y = held(machine, "y", law.inputs)
        u = exact.C @ x + exact.D @ y
        x = exact.A @ x + exact.B @ y
        error, size = max(error, np.abs(held(machine, "u", law.outputs) - u).max()), max(size, np.abs(u).max())
    print(f"{form}: largest error {error / size:.1e} of the largest command over {STEPS} steps")
    assert error <= DIGITS * size


def test_words_are_counted_as_emitted(rng):
    for states, anti_windup in ((30, False), (60, False), (60, True), (120, False), (170, False)):
        law = law_in(rng, states, "modal", anti_windup)
        code = c31_code(law)
        pad = sum(map(int, re.findall(r"\.space\s+(\d+)", code.assembly)))
        print(
            f"{states} states: {code.program_words} program, {code.data_words} data, {code.coefficient_words}"
            f" coefficients, {'internal' if code.coefficients_internal else 'external'}"
        )
        assert budget.words(law) == code.data_words + code.coefficient_words - pad
        assert code.coefficients_internal == (code.coefficient_words <= 896)


def test_assembly_stands_in_the_folder_when_asked(law_of, tmp_path):
    made = generate(law_of(10), tmp_path / "code", form="modal", limits_v=25.0, targets=("c99", "c31"))
    text, linker = ((tmp_path / "code" / f"controller_c31.{kind}").read_text() for kind in ("asm", "cmd"))
    machine = Machine(Program(text, linker))
    feed(machine, [0] * 6)
    machine.run("controller_frame")
    spent = machine.spent["controller_output"] + machine.spent["controller_update"]
    assert spent == made.tables["c31_kernel_cycles"]
    assert not (tmp_path / "plain").exists()
    generate(law_of(10), tmp_path / "plain", form="modal")
    assert not list((tmp_path / "plain").glob("*c31*"))


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        (
            {"form": "schur", "limits_v": 5.0, "targets": ("c99", "c31")},
            "C31 assembly is written for modal, delta and bank form, not for schur",
        ),
        ({"targets": ("c31",)}, "'targets' must list 'c99'"),
        ({"targets": "c99"}, "'targets' must list 'c99'"),
        ({"targets": ("c99", "c40")}, "'targets' must be one of"),
        ({"budget_share": 1.5}, "'budget_share' must lie between 0 and 1"),
        ({"budget_cycles": 0}, "'budget_cycles' must be"),
    ],
)
def test_refusals_leave_no_folder(settings, sentence, law_of, tmp_path):
    with pytest.raises(ValueError, match=sentence):
        generate(law_of(6), tmp_path / "code", **settings)
    assert not (tmp_path / "code").exists()


def test_gnu_assembler_takes_the_text(rng, tmp_path):
    gas = shutil.which("tic4x-coff-as")
    if gas is None:
        pytest.skip("no tic4x-coff-as (binutils for target tic4x-coff) on this machine")
    for form in ("modal", "delta", "bank", "bank-delta"):
        source = tmp_path / f"{form}.asm"
        law = bank_in(rng, (2, 0, 1), form, True) if form in ("bank", "bank-delta") else law_in(rng, 12, form, True)
        source.write_text(c31_code(law).assembly)
        done = subprocess.run(
            [gas, "-m31", source, "-o", tmp_path / "a.o"], capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, "")


MUTANTS = [
    (r"RND     R3\n        MPYF3", "NOP\n        MPYF3"),  # a state cut instead of rounded
    (r"\*-AR1\(IR0\)", "*-AR1(1)"),  # stored beside its place
    (r"ADDF3   R0,R1,R3", "ADDF3   R0,R1,R2"),  # into the other row's sum
    (r"LDI     5,BK", "LDI     4,BK"),  # a ring too short
    (r"LDI     2,IR0", "LDI     1,IR0"),
    (r"RPTS    12", "RPTS    11"),
    (r"LDFLT", "LDFGT"),
]


@pytest.mark.parametrize(("pattern", "instead"), MUTANTS)
def test_a_wrong_instruction_is_seen(pattern, instead, rng):
    law = law_in(rng, 8, limit_v=0.5)
    code = c31_code(law)
    text, changed = re.subn(pattern, instead, code.assembly, count=1)
    assert changed == 1
    right, wrong = machine_of(law), Machine(Program(text, code.linker))
    alike = True
    for _ in range(20):
        counts = rng.integers(-(2**15), 2**15, law.inputs)
        for machine in (right, wrong):
            feed(machine, counts)
            machine.run("controller_frame")
        alike = alike and right.memory == wrong.memory
    assert not alike


def small(*lines):
    """Return a machine with a few instructions; AR0 and AR1 point into blocks 0 and 1."""
    text = "\n".join(["        .text", "start:", *("        " + line for line in lines), "        RETI"])
    machine = Machine(Program(text.replace("        ||", "||"), "text: load = 0x809900\n"))
    machine.other |= {"AR0": 0x809A00, "AR1": 0x809C80, "IR0": 2}
    machine.memory |= dict.fromkeys([*range(0x8099F0, 0x809A10), *range(0x809C70, 0x809C90)], 0)
    return machine


@pytest.mark.parametrize(
    ("lines", "cycles"),
    [
        (["MPYF3 *AR0,*AR1,R0", "|| ADDF3 R0,R2,R2"], 1),
        (["STF R2,*AR0", "MPYF3 *AR0,*AR1,R0"], 3),  # a store before two reads
        (["STF R2,*AR1", "LDF *AR0,R0"], 2),
        (["LDI 1,IR0", "LDF *AR0,R0"], 4),  # a pointer's group written, then used
        (["LDI 1,IR0", "NOP", "NOP", "LDF *AR0,R0"], 4),
        (["MPYF3 *AR0,*-AR0(1),R0"], 2),  # two reads and the fetch in one block
        (["RPTS 9", "MPYF3 *AR0,*-AR0(1),R0"], 4 + 11),  # no fetch but the first
    ],
)
def test_interpreter_counts_what_holds_the_pipeline(lines, cycles):
    assert small(*lines).run("start") == cycles + 4


@pytest.mark.parametrize(
    "lines",
    [
        ["MACF R0,R1"],
        ["MPYF3 *AR0,R4,R0", "|| ADDF3 R0,R2,R2"],  # one source from memory
        ["MPYF3 *AR0,*AR1,R2", "|| ADDF3 R0,R2,R2"],  # the product's register
        ["MPYF3 *AR0,*AR1,R0", "|| ADDF3 R0,R2,R4"],
        ["MPYF3 *+AR0(2),*AR1,R0", "|| ADDF3 R0,R2,R2"],  # no bits for the displacement
        ["MPYF3 *AR0++(1),*AR0,R0", "|| ADDF3 R0,R2,R2"],
        ["LDF 0.1,R0"],
        ["LDF *AR7,R0"],  # reads what nobody wrote
    ],
)
def test_interpreter_refuses_what_the_c31_would_not_do(lines):
    with pytest.raises(RefusedError):
        small(*lines).run("start")


def test_the_twins_arithmetic_is_that_of_the_manual_on_integers(rng):
    words = rng.integers(0, 2**32, (2, 4000), dtype=np.uint64).astype(np.uint32)
    words &= np.uint32(0x1FFFFFFF)  # exponents 0 to 31 and their negatives below: no overflow
    words[1] |= np.uint32(0xE0000000)
    a, b = ([num.from_word(int(w)) for w in row] for row in words)
    fa, fb = (decode(row) for row in words)
    products = [num.multiply(p, q) for p, q in zip(a, b, strict=True)]
    assert np.array_equal(arithmetic.multiplied(fa, fb), [num.value(p) for p in products])
    sums = [num.add(p, q) for p, q in zip(products, a, strict=True)]
    assert np.array_equal(arithmetic.added(arithmetic.multiplied(fa, fb), fa), [num.value(s) for s in sums])
    assert np.array_equal(
        arithmetic.rounded(np.array([num.value(s) for s in sums])), [num.value(num.rounded(s)) for s in sums]
    )


def test_format_holds_every_single_and_rounds_the_rest(rng):
    bits = rng.integers(0, 2**32, 20000, dtype=np.uint64).astype(np.uint32).view(np.float32)
    singles = bits[np.isfinite(bits) & ((np.abs(bits) >= np.finfo(np.float32).tiny) | (bits == 0))].astype(float)
    assert np.array_equal(decode(encode(singles)), singles)
    assert [num.value(num.from_word(int(w))) for w in encode(singles[:500])] == singles[:500].tolist()
    many = rng.standard_normal(20000) * 10.0 ** rng.uniform(-30, 30, 20000)
    assert np.all(np.abs(decode(encode(many)) - many) <= 2.0**-24 * np.abs(many))
    with pytest.raises(ValueError, match="beyond the C31's numbers"):
        encode(4e38)
    with pytest.raises(ValueError, match="not finite"):
        encode(np.nan)
