"""Compilers, standards and flags: the same bits, or a refusal at compile time; never a guard that is missing."""

import itertools
import platform
import re
import shutil
import subprocess

import numpy as np
import pytest
from compilers_here import compiler
from deploy_laws import RANGES, code_in_words, random_law

from ultraquiet.deploy import generate
from ultraquiet.deploy.fixed_point.generation import generate_fixed
from ultraquiet.deploy.toolchain.compiler import CONTRACT_OFF
from ultraquiet.values import Channel, StateSpace

SOURCES = ("controller.c", "controller_selftest.c")
STANDARDS = {"gcc": ("-std=c99", "-std=c11", "-std=c17"), "clang": ("-std=c99", "-std=c11", "-std=c17")}
STANDARDS |= {"g++": ("-std=c++17",), "clang++": ("-std=c++17",)}
FLAGS = (
    "-O0",
    "-O1",
    "-O2",
    "-O3",
    "-Os",
    "-O3 -flto",
    "-O3 -march=native",
    f"-O3 -march=native {' '.join(CONTRACT_OFF)}",
    "-O2 -march=native -ffp-contract=fast",
    "-Ofast",
    "-Ofast -fno-fast-math",
    "-O2 -ffast-math",
    "-O3 -march=native -ffast-math",
    "-O2 -ffinite-math-only",
    "-O2 -ffinite-math-only -fno-signed-zeros",
    "-O2 -fno-signed-zeros",
    "-O2 -funsafe-math-optimizations",
    "-O2 -march=native -funsafe-math-optimizations",
    "-O2 -fassociative-math -fno-signed-zeros -fno-trapping-math",
    "-O2 -freciprocal-math",
    "-O2 -mfpmath=387",
    "-O2 -fno-trapping-math",
    "-O2 -fassociative-math",
    "-O2 -fno-honor-infinities",
    "-O2 -fno-honor-nans",
    "-O2 -mno-sse2",
    "-O2 -fsingle-precision-constant",
    "-O2 -frounding-math -fshort-enums -funsigned-char -fwrapv",
)
HARMLESS = {*FLAGS[:6], FLAGS[7], "-O2 -fno-trapping-math", FLAGS[-1]}  # what the source has no reason to refuse
LAWS = 28


def built(folder, name, flags, program):
    """Return what came of one build: refused, by the self-test where start-up code is at fault, same bits, or wrong."""
    language = ["-x", "c++"] if "++" in name else []
    command = [compiler(name), *flags.split(), "-w", "-DCONTROLLER_MAIN", *language, *SOURCES, "-o", str(program)]
    made = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    if made.returncode:
        ours = re.search(r'error: .*("controller: |controller_numbers_keep_their_type)', made.stderr)
        unknown = re.search(r"error: .*(unrecognized|not supported|unknown argument)", made.stderr)
        return "refused" if ours else "unknown flag" if unknown else f"broken: {made.stderr[:300]}"
    told = subprocess.run([program], capture_output=True, text=True, timeout=120, check=False)
    if "flushes denormal numbers" in told.stdout and of_its_own(command, folder, program) == 0:
        return "start-up refused"
    return "same bits" if told.returncode == 0 else f"other bits: {told.stdout.strip()}"


def of_its_own(command, folder, program):
    """Return how a program ends whose objects are these and whose start-up code was not chosen by the flags.

    Compilers link what flushes denormal numbers into programs with -Ofast, even where -fno-fast-math follows: the
    self-test refuses such a program, and no source can see it coming.
    """
    *compiling, _, _ = command
    parts = [part for part in compiling if part not in SOURCES]
    for k, source in enumerate(SOURCES):
        subprocess.run([*parts, "-c", source, "-o", f"{program}{k}.o"], cwd=folder, check=True, timeout=120)
    subprocess.run([command[0], *(f"{program}{k}.o" for k in range(len(SOURCES))), "-o", str(program)], check=True)
    return subprocess.run([program], capture_output=True, timeout=120, check=False).returncode


def builds():
    found = [name for name in STANDARDS if compiler(name)]
    if not found:
        pytest.skip("no C compiler on this machine")
    return [(name, f"{std} {flags}") for name in found for std in STANDARDS[name] for flags in FLAGS]


def drawn_law(rng, k):
    """A law of another size, form, precision and unit each time."""
    states, inputs, outputs = int(rng.integers(2, 16)), int(rng.integers(1, 6)), int(rng.integers(1, 6))
    unit = 10.0 ** float(rng.choice([-9, -3, 0, 3, 9]))
    law = random_law(rng, states, inputs, outputs, mixed=bool(k % 2))
    law = StateSpace(law.A, law.B * unit, law.C, law.D * unit, rate_hz=law.rate_hz)
    form = ("modal", "delta", "schur", "dense")[k % 4]
    return law, {"precision": ("float32", "float64")[k // 4 % 2], "form": form, "anti_windup": bool(k // 8 % 2)}


def test_flags_that_take_a_guard_away_are_refused_by_the_source(law_of, tmp_path):
    generate(law_of(6, 2, 3), tmp_path / "code", form="modal", anti_windup=True)
    fates = {}
    for name in filter(compiler, ("gcc", "clang")):
        for flags in ("-Ofast", "-O1 -ffinite-math-only", "-O1 -march=native -ffp-contract=fast"):
            fates[name, flags] = built(tmp_path / "code", name, f"-std=c99 {flags}", tmp_path / "run")
    for build, fate in fates.items():
        print(*build, fate)
        assert fate in ("refused", "same bits")
    assert all(
        fate == "refused" for (_, flags), fate in fates.items() if flags[-4:] == "fast" and "contract" not in flags
    )
    assert all(fate == "refused" for (_, flags), fate in fates.items() if "finite" in flags)


def test_cplusplus_links_against_the_header_and_compiles_the_source(law_of, tmp_path):
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler on this machine")
    code = tmp_path / "code"
    generate(law_of(4, 2, 2), code, form="modal")
    assert built(code, "g++", "-std=c++17 -O1", tmp_path / "run") == "same bits"
    (code / "main.cpp").write_text(
        '#include "controller.h"\nint main() { return controller_self_test() == 0U ? 0 : 1; }\n'
    )
    subprocess.run(["gcc", "-std=c99", "-O1", "-c", *SOURCES], cwd=code, check=True)
    objects = ["controller.o", "controller_selftest.o"]
    subprocess.run(["g++", "-std=c++17", "main.cpp", *objects, "-o", "main"], cwd=code, check=True)
    assert subprocess.run([code / "main"], check=False).returncode == 0


HOST = """
#include <fenv.h>
#include <stdio.h>
#if defined(__SSE__)
#include <xmmintrin.h>
#endif
#include "controller.h"
int main(void)
{
    %s;
    const unsigned long failed = controller_self_test();
    printf("%%lu", failed);
    return 0;
}
"""
FLUSHED, NEAREST = "flushed", "nearest"
SETTINGS = {
    "fesetround(FE_TONEAREST)": NEAREST,
    "fesetround(FE_UPWARD)": "row",
    "fesetround(FE_TOWARDZERO)": "row",
    "_mm_setcsr(_mm_getcsr() | 0x8000U)": FLUSHED,
    "_mm_setcsr(_mm_getcsr() | 0x0040U)": FLUSHED,
}


@pytest.mark.gate("float32")
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_what_another_part_of_the_program_switches_on_is_seen_by_the_self_test(law_of, tmp_path, precision):
    """No source sees how its program was linked (`-ffast-math` flushes to zero) or which way its thread rounds."""
    if compiler("gcc") is None:
        pytest.skip("no GCC on this machine")
    made = generate(law_of(6, 2, 3), tmp_path / "code", form="modal", precision=precision)
    rows = int(re.search(r"SCRIPT\[(\d+)\]", (made.folder / SOURCES[1]).read_text())[1])
    subprocess.run(["gcc", "-std=c99", "-O2", *CONTRACT_OFF, "-c", *SOURCES], cwd=made.folder, check=True)
    objects = ["controller.o", "controller_selftest.o", "-lm"]
    x86 = platform.machine() in {"x86_64", "AMD64"}
    told = {}
    for k, (setting, fate) in enumerate({**SETTINGS, "(void)0": FLUSHED}.items()):
        if not x86 and fate == FLUSHED:
            continue
        (made.folder / "main.c").write_text(HOST % setting)
        link = ["-ffast-math"] if k == len(SETTINGS) else []
        subprocess.run(["gcc", "-std=c99", "-c", "main.c"], cwd=made.folder, check=True)
        subprocess.run(["gcc", *link, "main.o", *objects, "-o", "main"], cwd=made.folder, check=True)
        row = int(subprocess.run([made.folder / "main"], capture_output=True, text=True, check=True).stdout)
        told[setting, *link] = {0: NEAREST, rows + 1: FLUSHED}.get(row, "row")
        assert told[setting, *link] == fate, told
    print(told)


def undefined(name, flags, folder, source):
    subprocess.run([compiler(name), "-std=c99", *flags.split(), "-c", source, "-o", "made.o"], cwd=folder, check=True)
    said = subprocess.run(["nm", "-u", "made.o"], cwd=folder, capture_output=True, text=True, check=True).stdout
    return said.split()[1::2]


EVERY_LEVEL = ("-O0", "-O2", "-O3 -march=native -DULTRAQUIET_CONTRACT_OFF", "-Os")


@pytest.mark.slow
def test_numbers_of_another_type_are_refused_and_other_orders_taken_back(law_of, tmp_path):
    if compiler("gcc") is None:
        pytest.skip("no GCC on this machine")
    made = {}
    for precision in ("float32", "float64"):
        generate(law_of(6, 2, 3), tmp_path / precision, form="modal", precision=precision)
        for flags in ("-fassociative-math", "-fsingle-precision-constant", "-Dfloat=double"):
            made[precision, flags] = built(tmp_path / precision, "gcc", f"-std=c99 -O2 {flags}", tmp_path / "run")
    print(made)
    assert [fate for (_, flags), fate in made.items() if "associative" in flags] == ["same bits"] * 2
    assert made["float32", "-fsingle-precision-constant"] == "same bits"
    assert made["float64", "-fsingle-precision-constant"] == "refused"
    assert [fate for (_, flags), fate in made.items() if "-D" in flags] == ["refused", "same bits"]


@pytest.mark.parametrize(
    ("states", "levels"), [(8, EVERY_LEVEL[1:2]), pytest.param(60, EVERY_LEVEL, marks=pytest.mark.slow)]
)
def test_the_object_calls_nothing_that_it_does_not_define(law_of, tmp_path, states, levels):
    if shutil.which("nm") is None:
        pytest.skip("no nm on this machine")
    generate(law_of(states), tmp_path / "float", form="modal", anti_windup=True)
    generate_fixed(law_of(8, 2, 2), tmp_path / "fixed", "q31", tolerance=1.0, **RANGES)
    for folder in ("float", "fixed"):
        for name in filter(compiler, ("gcc", "clang")):
            for flags in levels:
                assert undefined(name, flags, tmp_path / folder, "controller.c") == [], (name, flags, folder)


GAINS = (1e-30, 1e-12, 1e12, 1e30)
SIZES = ((1, 1), (4, 3), (3, 5))


def extreme_law(rng, gain, inputs, outputs, k):
    """A law whose commands are that much smaller or larger than its measurements, with limits that fit or do not."""
    law = random_law(rng, 5, inputs, outputs)
    law = StateSpace(law.A, law.B, gain * law.C, gain * law.D, rate_hz=law.rate_hz)
    limits = {"limits_v": 10 * gain} if k % 2 else {}
    form = ("modal", "delta", "schur", "dense")[k % 4]
    return law, {"precision": ("float32", "float64")[k // 4 % 2], "form": form, "anti_windup": bool(k % 3)} | limits


def matrix(laws, builds_of, folder):
    """Build and run each law with its builds; print the counts, return what is wrong."""
    counts, wrong = {}, []
    for k, ((law, settings), builds) in enumerate(zip(laws, builds_of, strict=True)):
        generate(law, folder / "code", **settings)
        for name, flags in builds:
            fate = built(folder / "code", name, flags, folder / "run")
            word = fate.partition(":")[0]
            of_it = counts.setdefault(name, {})
            of_it[word] = of_it.get(word, 0) + 1
            harmless = flags.partition(" ")[2] in HARMLESS
            if word in ("broken", "other bits") or (harmless and word != "same bits"):
                wrong.append((k, settings, name, flags, fate))
    for name, of_it in counts.items():
        print(f"{name}: {of_it}")
        assert of_it["same bits"] > 0
        assert of_it["refused"] > 0
    return wrong


def dealt(rng, every, hands, each):
    """Return hands of so many builds, none met again before all have been."""
    order = itertools.chain.from_iterable(rng.permutation(len(every)) for _ in itertools.count())
    return [[every[k] for k in itertools.islice(order, each)] for _ in range(hands)]


@pytest.mark.slow
@pytest.mark.timeout(5400)
def test_compilers_times_standards_times_flags(tmp_path, share):
    """Every law meets a share of the builds; together they meet each twice, with `--whole` three times."""
    rng, every = np.random.default_rng(16), builds()
    laws = [drawn_law(rng, k) for k in range(LAWS)]
    times = len(share(range(3), 2))
    wrong = matrix(laws, dealt(rng, every, LAWS, -(-times * len(every) // LAWS)), tmp_path)
    print(f"{LAWS} laws, each of {len(every)} builds met {times} times or more, {len(wrong)} wrong")
    assert not wrong, wrong[:3]


@pytest.mark.slow
@pytest.mark.timeout(5400)
def test_compilers_times_laws_with_tiny_and_huge_gains(tmp_path, share):
    """The same for commands far from one: together they meet each build twice; with `--whole` each law meets all."""
    rng, every, cases = np.random.default_rng(17), builds(), list(itertools.product(GAINS, SIZES))
    laws = [extreme_law(rng, gain, *size, k) for k, (gain, size) in enumerate(cases)]
    each = len(share(every, -(-2 * len(every) // len(laws))))
    wrong = matrix(laws, dealt(rng, every, len(laws), each), tmp_path)
    print(f"{len(laws)} laws of gains {GAINS}, {each} of {len(every)} builds each, {len(wrong)} wrong")
    assert not wrong, wrong[:3]


def decisions(text):
    """Return the conditions of every decision with two operators or more; the preprocessor decides before it runs."""
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    code = re.sub(r"^#.*$", "", code, flags=re.MULTILINE)
    found = []
    for match in re.finditer(r"\bif \(|= \(|return ", code):
        start = match.end() - (1 if match.group().endswith("(") else 0)
        depth, at = 0, start
        while not (depth == 0 and code[at] in ";{?"):
            depth += {"(": 1, ")": -1}.get(code[at], 0)
            at += 1
        if "&&" in code[start:at] or "||" in code[start:at]:
            found.append(code[start:at])
    return found


def parts(expression, operator):
    """Return an expression's parts at an operator outside all parentheses."""
    depth, last, found = 0, 0, []
    for k, c in enumerate(expression):
        depth += {"(": 1, ")": -1}.get(c, 0)
        if depth == 0 and expression.startswith(operator, k):
            found.append(expression[last:k])
            last = k + len(operator)
    return [*found, expression[last:]]


def parsed(expression, counter):
    """Return an expression as ("||", left, right), ("&&", left, right) or ("leaf", number)."""
    for operator in ("||", "&&"):
        first, *others = parts(expression, operator)
        if others:
            node = parsed(first, counter)
            for other in others:
                node = (operator, node, parsed(other, counter))
            return node
    inner = expression.strip()
    if inner.startswith("(") and inner.endswith(")") and ("&&" in inner or "||" in inner):
        return parsed(inner[1:-1], counter)
    return ("leaf", next(counter))


def is_tree(expression):
    """Whether short-circuit evaluation reaches no condition by two ways: then branches of conditions are MC/DC.

    Comar, Guitton, Hainque and Quinot, "Formalization and comparison of MCDC and object branch coverage criteria",
    ERTS 2012: object branch coverage is MC/DC just for decisions whose decision diagram is a tree.
    """
    reached = {}
    counter = itertools.count()

    def walk(node, true, false):
        """Return the first condition; `true` and `false` are where evaluation goes on."""
        if node[0] == "leaf":
            for end in (true, false):
                if not isinstance(end, bool):
                    reached[end] = reached.get(end, 0) + 1
            return node[1]
        if node[0] == "&&":
            return walk(node[1], walk(node[2], true, false), false)
        return walk(node[1], true, walk(node[2], true, false))

    walk(parsed(expression, counter), True, False)
    return all(count == 1 for count in reached.values())


def covered(folder, source):
    """Return what gcov says of a source after its self-test: shares of lines and of branches of conditions."""
    command = ["gcc", "-std=c99", "-O0", "--coverage", "-DCONTROLLER_MAIN", *SOURCES, "-o", "covered"]
    subprocess.run(command, cwd=folder, check=True)
    subprocess.run([folder / "covered"], cwd=folder, check=True, capture_output=True)
    data = next(folder.glob(f"*{source.removesuffix('.c')}.gcda"))
    said = subprocess.run(
        ["gcov", "-b", "-c", data.name], cwd=folder, capture_output=True, text=True, check=True
    ).stdout
    part = said.partition(f"File '{source}'")[2]
    lines = re.search(r"Lines executed:([\d.]+)% of (\d+)", part)
    branches = re.search(r"Taken at least once:([\d.]+)% of (\d+)", part)
    return (float(lines[1]), int(lines[2])), (float(branches[1]), int(branches[2]))


@pytest.mark.gate("modal-True")
@pytest.mark.parametrize("aware", [True, False])
@pytest.mark.parametrize("form", ["modal", "delta", "schur", "dense", "q15", "q31"])
def test_the_self_test_covers_every_line_branch_and_condition(rng, tmp_path, form, aware):
    if shutil.which("gcov") is None or shutil.which("gcc") is None:
        pytest.skip("no gcc with gcov on this machine")
    folder = tmp_path / "code"
    if form.startswith("q"):
        code_in_words(rng, folder, form, 8, 2, 3, scaling="l2" if aware else "l1")
    else:
        generate(random_law(rng, 7, 3, 2), folder, form=form, anti_windup=aware)
    (lines, of_lines), (branches, of_branches) = covered(folder, "controller.c")
    found = decisions((folder / "controller.c").read_text())
    trees = sum(map(is_tree, found))
    print(
        f"{form}, anti-windup {aware}: {lines} % of {of_lines} lines, {branches} % of {of_branches} branches; of "
        f"{len(found)} decisions of several conditions {trees} are trees, for which that is MC/DC"
    )
    assert (lines, branches) == (100.0, 100.0)
    assert trees == len(found)


def test_a_tree_of_conditions_is_told_from_a_diamond():
    assert is_tree("((a == b) && ((c) || (d != 0U)))")
    assert is_tree("a || (b && c)")
    assert not is_tree("(a && b) || c")
    assert len(decisions("#if (d) && (e)\n#endif\nif ((a) && (b)) { }\nx = ((a || b) ? 1 : 0);\nif (a) { }")) == 2


@pytest.mark.gate("float32-1e30-1e-30")
@pytest.mark.parametrize(("y_unit", "u_unit"), [("1e9", "1e-9"), ("1e-9", "1e9"), ("1e30", "1e-30"), ("1e38", "1e38")])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_constants_exist_in_their_type_whatever_the_units(rng, tmp_path, cc, precision, y_unit, u_unit):
    """Anti-windup too: what the sensors count in does not decide whether there is a gain."""
    y, u, law = float(y_unit), float(u_unit), random_law(rng, 6, 2, 2)
    limits = [Channel(name, "x", -10 * u, 10 * u) for name in "ab"]
    law = StateSpace(law.A, law.B / y, law.C * u, law.D * (u / y), law.rate_hz, sensors=limits)
    made = generate(law, tmp_path / "code", precision, anti_windup=True, form="modal")
    command = [cc, "-std=c99", "-O1", *CONTRACT_OFF, "-Wall", "-Werror", "-DCONTROLLER_MAIN", *SOURCES, "-o", "run"]
    subprocess.run(command, cwd=made.folder, check=True)
    assert subprocess.run([made.folder / "run"], check=False).returncode == 0


@pytest.mark.gate("1e-36", "1e+30")
@pytest.mark.parametrize("gain", [1e-36, 1e-30, 1e-12, 1e12, 1e30], ids="{:.0e}".format)
def test_every_constant_is_a_normal_number_of_its_type(rng, tmp_path, gain):
    """A denormal one would be zero where a processor flushes them: other bits than the generator's."""
    law = random_law(rng, 7, 4, 3)
    law = StateSpace(law.A, law.B, gain * law.C, gain * law.D * np.geomspace(1.0, 1e-3, 4), law.rate_hz)
    generate(law, tmp_path / "code", form="dense", anti_windup=True, limits_v=10 * gain)
    text = "".join(path.read_text() for path in (tmp_path / "code").glob("*.[ch]"))
    sizes = np.array([abs(float.fromhex(n)) for n in re.findall(r"0x[01]\.?[0-9a-f]*p[+-]?\d+", text)])
    print(f"gain {gain:g}: {sizes.size} constants, {sizes[sizes > 0].min():.1e} to {sizes.max():.1e} and zero")
    known = np.finfo(np.float32)
    assert np.all((sizes == 0) | (sizes >= known.tiny))
    assert sizes.max() <= known.max
