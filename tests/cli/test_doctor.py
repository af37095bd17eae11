"""The doctor says what is slow and how to mend it, for what it is told of a machine."""

from pathlib import Path

import pytest

from ultraquiet.cli.doctor import speed
from ultraquiet.deploy.toolchain.targets import families


@pytest.mark.parametrize(
    ("row", "found", "mend"),
    [
        (lambda folder: speed._linear_algebra([]), "no optimised BLAS", "pip install"),
        (lambda folder: speed._linear_algebra([{"internal_api": "netlib", "num_threads": 1}]), "netlib", "pip install"),
        (
            lambda folder: speed._linear_algebra([{"internal_api": "openblas", "num_threads": 4096}]),
            "4096 threads",
            "export OPENBLAS_NUM_THREADS=",
        ),
        (lambda folder: speed._kernels(folder / "file" / "cache", "0"), "cannot be written to", "NUMBA_CACHE_DIR"),
        (lambda folder: speed._kernels(folder, "1"), "NUMBA_DISABLE_JIT", "unset"),
        (lambda folder: speed._processors(8, 2), "2 of 8", "taskset"),
        (lambda folder: speed._system("Windows"), "refused", "WSL"),
        (lambda folder: speed._system("Darwin"), "not tested", "report"),
    ],
)
def test_what_is_slow_is_said_with_its_remedy(row, found, mend, tmp_path):
    (tmp_path / "file").write_text("no folder")
    _, says, _, remedy = row(tmp_path)
    assert found in says
    assert mend in remedy


def test_what_is_well_needs_no_remedy(tmp_path):
    assert speed._linear_algebra([{"internal_api": "openblas", "num_threads": 1}])[3] == ""
    assert speed._kernels(tmp_path, "0")[3] == ""
    assert speed._processors(2, 2)[3] == ""
    assert speed._system("Linux")[3] == ""


def test_the_command_prints_them(run):
    out = run("doctor")[1]
    assert all(program in out for family, _ in families() for program in family.programs)
    for words in ("speed: linear algebra", "speed: compiled kernels", "speed: processors", "system"):
        assert words in out


def test_platforms_are_named_in_the_documentation():
    page = (Path(__file__).parents[2] / "docs" / "reference" / "platforms.md").read_text()
    for name in ("Linux", "macOS", ["Windows", " refused"][0]):
        assert name in page
