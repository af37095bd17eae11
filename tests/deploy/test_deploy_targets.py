"""Another processor is one entry of a table, another family of processors one folder."""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ultraquiet.deploy import FrameTimes, Processor, generate
from ultraquiet.deploy.exchange.cmake import write_project
from ultraquiet.deploy.figures import said
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.deploy.toolchain import targets
from ultraquiet.deploy.toolchain.cortex_m.processors import CORTEX_M
from ultraquiet.deploy.toolchain.target import Memory, Target
from ultraquiet.deploy.toolchain.targets import TARGETS, missing_program
from ultraquiet.pipeline.facts.typed import to_plain
from ultraquiet.pipeline.making.code import deployed
from ultraquiet.pipeline.report.code import code as code_section
from ultraquiet.pipeline.tables.code import Deploy
from ultraquiet.values import StateSpace

# A part with another core on another board: other memory, and a SysTick of 20 MHz.
CORTEX_M33 = Target(
    CORTEX_M,
    "cortex-m33",
    "Cortex-M33",
    ("-mcpu=cortex-m33", "-mthumb", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard"),
    "mps2-an505",
    20.48,
    160e6,
    "STM32U5, 160 MHz",
    in_hardware=("float32",),
    memory=Memory(code=0x1000_0000, data=0x3800_0000),
)

# A part without a unit for any floating-point number, on the family's usual kind of board.
CORTEX_M3 = Target(
    CORTEX_M,
    "cortex-m3",
    "Cortex-M3",
    ("-mcpu=cortex-m3", "-mthumb"),
    "mps2-an385",
    25.6,
    120e6,
    "STM32F2, 120 MHz",
    in_hardware=(),
)


BUILT_IN = list(TARGETS)
UNLISTED = [target for target in (CORTEX_M33, CORTEX_M3) if target.name not in TARGETS]


@pytest.fixture
def emulated():
    absent = missing_program()
    if absent is not None:
        pytest.skip(f"'{absent}' is not installed (Debian: {' '.join(CORTEX_M.packages)})")


@pytest.fixture(params=UNLISTED, ids=lambda target: target.name)
def another(request, monkeypatch):
    """The table with one more entry."""
    monkeypatch.setitem(TARGETS, request.param.name, request.param)
    return request.param


def test_the_processors_that_laws_were_flown_on_are_built_in():
    assert {"cortex-m4f", "cortex-m7"} <= set(BUILT_IN)
    assert [TARGETS[name].title for name in ("cortex-m4f", "cortex-m7")] == ["Cortex-M4F", "Cortex-M7"]


@pytest.mark.slow
@pytest.mark.usefixtures("emulated", "cc")
def test_a_new_cortex_m_is_one_entry_of_the_table(another, law_of, tmp_path):
    made = generate(law_of(6, 2, 3), tmp_path / "code", form="modal", ramp_s=0.01)
    found = made.verify(steps=300, fuzz_steps=0)
    print(found.status, *found.targets, sep="\n")
    assert found.ok
    assert [each.target.name for each in found.targets] == [*BUILT_IN, another.name]
    assert found.on(another.name).bit_exact
    assert found.on(another.name).flash_bytes > 0
    assert made.tables[f"{another.key}_instructions"] == found.on(another.name).step
    times = FrameTimes.on_target(made, another.name)
    assert another.title in times.source
    with Processor(made, target=another.name) as processor:
        y = np.random.default_rng(0).standard_normal((2, 20))
        twin = Twin(made.law)
        twin.reset()
        assert np.array_equal(processor.run(y), twin.run(y))


@pytest.mark.gate("cortex-m33")
@pytest.mark.usefixtures("emulated", "cc")
def test_a_study_counts_on_the_new_one_and_its_report_says_so(another, law_of, tmp_path):
    asked = Deploy(processors=[another.name])
    law, limits = law_of(4, 3, 2), np.array([[-1.0, 1.0]] * 2)
    plant = StateSpace([[0.5]], 1e-6 * np.ones((1, 2)), np.ones((3, 1)), np.zeros((3, 2)), law.rate_hz)
    facts = deployed("calm", law, plant, limits, tmp_path, asked, []).facts
    print(facts)
    assert facts.instructions_on[another.name] > facts.output_instructions_on[another.name] > 0
    study = SimpleNamespace(deploy=asked, paper=None)
    section = code_section(SimpleNamespace(study=study, deployment={"calm": facts}, designs={}))
    table = section.tables[0]
    row = dict(zip(table.columns, table.rows[0], strict=True))
    assert row[f"{another.title}, instructions a sample"] == str(facts.instructions_on[another.name])
    on_page = said({"instructions_on": to_plain(facts)["instructions_on"]})
    assert on_page == [("instructions a sample on", f"{another.name} {facts.instructions_on[another.name]}")]


@pytest.mark.gate("cortex-m33")
@pytest.mark.usefixtures("emulated", "cc")
def test_makefile_and_project_build_for_the_new_one(another, law_of, tmp_path):
    made = generate(law_of(4, 2, 2), tmp_path / "code", form="modal", ramp_s=0.01)
    told = ran(["make", f"check-{another.name}"], made.folder)
    assert "self-test 0" in told
    project = write_project(made, tmp_path / "project")
    assert f"{', '.join(BUILT_IN)}, {another.name}]" in (project / ".github/workflows/ci.yml").read_text()
    if shutil.which("cmake") is None:
        pytest.skip("no cmake on this machine")
    for name in ("cortex-m7", another.name):
        build = f"build-{name}"
        ran(["cmake", "-B", build, "--toolchain", f"cmake/{name}.cmake"], project)
        ran(["cmake", "--build", build], project)
        assert "100% tests passed" in ran(["ctest", "--test-dir", build], project)


def test_without_it_no_file_knows_of_it(law_of, tmp_path):
    made = generate(law_of(4, 2, 2), tmp_path / "code", form="modal", ramp_s=0.01)
    write_project(made, tmp_path / "project")
    texts = [path.read_text() for path in tmp_path.rglob("*") if path.is_file()]
    absent = [word for target in UNLISTED for word in (target.name, target.title, target.machine)]
    absent += ["m33", "an505"] if CORTEX_M33 in UNLISTED else []
    assert not any(word in text for text in texts for word in absent)


@pytest.mark.slow
@pytest.mark.usefixtures("emulated", "cc")
def test_another_family_is_one_folder(law_of, tmp_path, monkeypatch):
    """A family whose folder is found beside the others brings its own compiler, emulator, program and rules."""
    folder = tmp_path / "rooms" / "other_family"
    shutil.copytree(CORTEX_M.folder, folder, ignore=shutil.ignore_patterns("__pycache__"))
    table = (folder / "processors.py").read_text()
    other_words = {'stem="cortex"': 'stem="other"', '"cortex-m': '"other-m', 'processor="arm"': 'processor="x"'}
    for word, other in other_words.items():
        assert word in table
        table = table.replace(word, other)
    (folder / "processors.py").write_text(table)
    rules = (folder / "rules.mk.j2").read_text().replace("CROSS", "OTHER").replace("TARGET_FILES", "OTHER_FILES")
    (folder / "rules.mk.j2").write_text(rules)
    with monkeypatch.context() as patch:
        room = [*targets.toolchain.__path__, str(folder.parent)]
        patch.setattr(targets.toolchain, "__path__", room)
        both = {target.name: target for target in targets.targets_in(room)}
    for name in [name for name in sys.modules if ".other_family" in name]:
        monkeypatch.delitem(sys.modules, name)
    assert list(both) == [*BUILT_IN, *(name.replace("cortex", "other") for name in BUILT_IN)]
    for name, target in both.items():
        monkeypatch.setitem(TARGETS, name, target)
    made = generate(law_of(4, 2, 2), tmp_path / "code", form="modal", ramp_s=0.01)
    assert {"controller_cortex.c", "controller_other.c", "controller_other.ld"} <= names(made.folder)
    assert "self-test 0" in ran(["make", "check-other-m7"], made.folder)
    found = made.verify(steps=200, targets=("cortex-m7", "other-m7"), fuzz_steps=0)
    assert found.ok
    assert found.on("other-m7").step == found.on("cortex-m7").step
    text = (write_project(made, tmp_path / "project") / "CMakeLists.txt").read_text()
    assert 'elseif(CMAKE_CROSSCOMPILING AND CMAKE_SYSTEM_PROCESSOR STREQUAL "x")' in text


@pytest.mark.usefixtures("cc")
def test_a_family_without_its_programs_says_which(law_of, tmp_path, monkeypatch):
    family = replace(CORTEX_M, stem="cortex", compiler="no-such-gcc")
    monkeypatch.setitem(TARGETS, "cortex-m7", replace(TARGETS["cortex-m7"], family=family))
    made = generate(law_of(2, 1, 1), tmp_path / "code", ramp_s=0.01)
    found = made.verify(steps=50, targets=("cortex-m7",), fuzz_steps=0)
    assert found.ok
    assert found.missing == ("'no-such-gcc' is not installed, so nothing was run or counted on Cortex-M7.",)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def ran(command: list[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout + done.stderr
