"""Generated code as a project of its own: CMake builds it, ctest runs its self-test, also on emulated processors."""

import re
import shutil
import subprocess
from xml.etree import ElementTree

import pytest

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.deploy import generate
from ultraquiet.deploy.exchange.cmake import write_project
from ultraquiet.deploy.toolchain.targets import TARGETS


@pytest.fixture
def cmake():
    found = shutil.which("cmake"), shutil.which("ctest")
    if None in found or not (shutil.which("make") or shutil.which("ninja")):
        pytest.skip("no cmake, ctest or make on this machine")
    return found[0]


def run(*command, folder):
    return subprocess.run([*map(str, command)], cwd=folder, capture_output=True, text=True, timeout=300, check=False)


def built(cmake, project, *settings):
    """Configure, build and test in a folder of its own; return how many tests ctest counts as run, and as failed.

    Counted in the report that ctest writes for programs: what it says to people differs between its versions.
    """
    for command in ([cmake, "-B", "build", *settings], [cmake, "--build", "build"]):
        done = run(*command, folder=project)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        assert "warning" not in (done.stdout + done.stderr).lower()
    report = project / "build" / "tests.xml"
    report.unlink(missing_ok=True)
    done = run("ctest", "--test-dir", "build", "--output-on-failure", "--output-junit", report, folder=project)
    suite = ElementTree.parse(report).getroot()
    tests, failures = int(suite.attrib["tests"]), int(suite.attrib["failures"])
    assert (done.returncode == 0) == (failures == 0), done.stdout[-2000:] + done.stderr[-2000:]
    return tests, failures


@pytest.mark.usefixtures("cc")
def test_cmake_builds_it_and_ctest_passes(cmake, law_of, tmp_path):
    made = generate(law_of(12), tmp_path / "code", name="strut_law")
    project = write_project(made, tmp_path / "project")
    assert built(cmake, project) == (1, 0)
    prefix = tmp_path / "there"
    assert run(cmake, "--install", "build", "--prefix", prefix, folder=project).returncode == 0
    assert {p.name for p in prefix.rglob("*.*")} == {"libstrut_law.a", "strut_law.h"}


@pytest.mark.usefixtures("cc")
def test_ctest_fails_when_a_coefficient_was_changed(cmake, law_of, tmp_path):
    project = write_project(generate(law_of(4), tmp_path / "code"), tmp_path / "project")
    path = project / "src" / "controller_coefficients.h"
    text = path.read_text()
    numbers = [m.end() for m in re.finditer(r"0x1\.", text)]
    at = numbers[len(numbers) // 2]  # among B, C and D, which are most of them
    path.write_text(text[:at] + ("0" if text[at] != "0" else "8") + text[at + 1 :])
    assert built(cmake, project) == (1, 1)


@pytest.mark.slow
@pytest.mark.usefixtures("cc")
def test_another_project_can_take_it_in(cmake, law_of, tmp_path):
    write_project(generate(law_of(4), tmp_path / "code"), tmp_path / "host" / "controller")
    (tmp_path / "host" / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.21)\nproject(host C)\nadd_subdirectory(controller)\n"
        "add_executable(host main.c)\ntarget_link_libraries(host PRIVATE controller::controller)\n"
    )
    (tmp_path / "host" / "main.c").write_text(
        '#include "controller.h"\nstatic controller_state s;\n'
        "int main(void) { controller_init(&s, 0); return controller_enable(&s) ? 7 : 1; }\n"
    )
    for command in ([cmake, "-B", "build"], [cmake, "--build", "build"]):
        assert run(*command, folder=tmp_path / "host").returncode == 0
    assert run(tmp_path / "host" / "build" / "host", folder=tmp_path).returncode == 7


@pytest.mark.gate("cortex-m7")
@pytest.mark.parametrize("target", list(TARGETS))
def test_toolchain_files_build_and_run_it_on_emulated_processors(target, cmake, law_of, tmp_path):
    if TARGETS[target].family.missing_program():
        pytest.skip(f"no {TARGETS[target].family.missing_program()} on this machine")
    project = write_project(generate(law_of(6), tmp_path / "code"), tmp_path / "project")
    assert built(cmake, project, "--toolchain", f"cmake/{target}.cmake") == (1, 0)
    elf = (project / "build" / "controller_selftest.elf").read_bytes()
    assert elf[:4] == b"\x7fELF"
    assert elf[18:20] == b"\x28\x00"  # EM_ARM
    path = project / "src" / "controller_selftest.c"
    text = path.read_text()
    digest = re.findall(r"0x[0-9A-F]{8}U", text)[-1]
    path.write_text(text.replace(digest, f"0x{int(digest[2:-1], 16) ^ 1:08X}U"))
    assert built(cmake, project) == (1, 1)  # the folder of the build remembers its processor


def test_the_folder_is_whole_and_says_whose_it_is(law_of, tmp_path):
    made = generate(law_of(6), tmp_path / "code")
    project = write_project(made, tmp_path / "project", owner="Strut & Sons")
    held = {str(p.relative_to(project)) for p in project.rglob("*") if p.is_file()}
    print(sorted(held))
    assert {
        *("CMakeLists.txt", "README.md", "LICENSE", ".gitignore", ".github/workflows/ci.yml", "CONTROLLER.md"),
        *("manifest.json", "vectors.csv", *(f"cmake/{name}.cmake" for name in TARGETS)),
        *("src/controller.c", "src/controller.h", "src/controller_coefficients.h", "src/controller_selftest.c"),
    } <= held
    for path in made.folder.glob("controller*"):
        assert (project / "src" / path.name).read_bytes() == path.read_bytes()
    assert "belong to Strut & Sons." in (project / "LICENSE").read_text()
    workflow = (project / ".github/workflows/ci.yml").read_text()
    assert f"target: [{', '.join(TARGETS)}]" in workflow
    assert re.findall(r"\$\{\{ .*? \}\}", workflow) == ["${{ matrix.compiler }}", "${{ matrix.target }}"]
    assert not re.search(r"\t| $", workflow, re.M)
    assert {len(line) - len(line.lstrip()) for line in workflow.splitlines()} == {0, 2, 4, 6, 8}
    again = write_project(made, project)  # it replaces what it wrote
    assert "belong to whoever had them designed." in (again / "LICENSE").read_text()


def test_what_cannot_be_written_is_refused_and_leaves_nothing(law_of, tmp_path):
    made = generate(law_of(4), tmp_path / "code")
    for owner in ("", "a\nb"):
        with pytest.raises(InputError, match="'owner' must be one line"):
            write_project(made, tmp_path / "project", owner)
    with pytest.raises(InputError, match="a folder of its own"):
        write_project(made, made.folder)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("do not lose")
    with pytest.raises(StorageError, match="holds something this program did not write"):
        write_project(made, tmp_path / "mine")
    shutil.rmtree(made.folder)
    with pytest.raises(StorageError, match="generate the code again"):
        write_project(made, tmp_path / "project")
    assert [p.name for p in tmp_path.iterdir()] == ["mine"]
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "do not lose"
