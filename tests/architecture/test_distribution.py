"""What is shipped: wheel and source archive, built, looked into, installed and used on every Python at hand."""

import functools
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
TIMEOUT_S = 1500
USE = """
import sys
import ultraquiet as uq
from importlib.metadata import version
from ultraquiet.testing import problems

assert version("ultraquiet") == sys.argv[1], version("ultraquiet")
assert sys.argv[2] in uq.__file__, uq.__file__
record, plant = problems.two_modes(seed=1)
found = uq.identify.Arx(order=4).identify(record)
law = uq.design.Lqg().design(problems.damped_plant(1)).controller
code = uq.deploy.generate(law, sys.argv[2] + "/code")
proof = code.verify()
assert proof.status.ok or proof.status.word == "no compiler", proof.status
uq.files.save(law, sys.argv[2] + "/law.h5")
assert uq.files.load(sys.argv[2] + "/law.h5").hash == law.hash
print(sys.version.split()[0], found, proof.status.word)
"""


@functools.cache
def interpreter(version):
    """Path of a Python of this version that starts and can make environments; None where there is none."""
    pyenv = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python{version}"))
    for path in filter(None, (shutil.which(f"python{version}"), *map(str, pyenv))):
        done = subprocess.run([path, "-c", "import venv, ensurepip"], capture_output=True, check=False)
        if done.returncode == 0:
            return path
    return None


def shipped():
    """Files of the package that version control knows; what lies about besides is not counted."""
    listed = subprocess.run(["git", "ls-files", "src/ultraquiet"], cwd=ROOT, capture_output=True, text=True, check=True)
    return {line.removeprefix("src/") for line in listed.stdout.splitlines() if (ROOT / line).exists()}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    out = tmp_path_factory.mktemp("dist")
    pytest.importorskip("hatchling")
    done = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", str(out)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return out


def test_versions_agree():
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"version: {PROJECT['version']}" in citation
    assert f"## {PROJECT['version']}" in (ROOT / "CHANGELOG.md").read_text()
    assert (ROOT / "src" / "ultraquiet" / "py.typed").exists()


@pytest.mark.slow
def test_a_wheel_holds_every_file_of_the_package(built):
    (wheel,) = built.glob("*.whl")
    held = {name for name in zipfile.ZipFile(wheel).namelist() if name.startswith("ultraquiet/")}
    assert shipped() <= held, sorted(shipped() - held)
    assert "ultraquiet/py.typed" in held
    assert not [name for name in held if "__pycache__" in name]
    print(f"{wheel.name}: {len(held)} files, {wheel.stat().st_size / 1e6:.1f} MB")


@pytest.mark.slow
def test_a_source_archive_holds_what_builds_it(built):
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        held = {name.partition("/")[2] for name in opened.getnames()}
    assert {f"src/{name}" for name in shipped()} <= held
    assert {"pyproject.toml", "LICENSE", "CHANGELOG.md", "CITATION.cff", "README.md"} <= held
    print(f"{archive.name}: {len(held)} files, {archive.stat().st_size / 1e6:.1f} MB")


@pytest.mark.slow
@pytest.mark.timeout(TIMEOUT_S)
@pytest.mark.parametrize("version", PYTHONS)
@pytest.mark.parametrize("kind", ["*.whl", "*.tar.gz"])
def test_it_is_installed_and_used(built, version, kind, tmp_path):
    if interpreter(version) is None:
        pytest.skip(f"there is no Python {version} on this machine")
    (archive,) = built.glob(kind)
    place = tmp_path / "venv"
    clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "PYTHONPYCACHEPREFIX")}
    subprocess.run([interpreter(version), "-m", "venv", str(place)], env=clean, check=True)
    python = str(place / "bin" / "python")
    quiet = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    done = subprocess.run([*quiet, str(archive)], capture_output=True, text=True, env=clean, check=False)
    if "No matching distribution" in done.stderr or "Connection" in done.stderr:
        pytest.skip(f"the package index cannot be reached: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    used = subprocess.run(
        [python, "-W", "error::DeprecationWarning:ultraquiet", "-c", USE, PROJECT["version"], str(tmp_path)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=clean,
        check=False,
    )
    print(used.stdout)
    assert used.returncode == 0, used.stdout + used.stderr
    told = subprocess.run(
        [str(place / "bin" / "ultraquiet"), "doctor"], capture_output=True, text=True, env=clean, check=False
    )
    assert told.returncode == 0, told.stdout + told.stderr
    assert PROJECT["version"] in told.stdout


def test_what_is_promised_is_tried():
    """Every Python that the package says it runs on."""
    lowest = PROJECT["requires-python"].removeprefix(">=")
    named = [c.rpartition(" ")[2] for c in PROJECT.get("classifiers", []) if re.search(r":: 3\.\d+$", c)]
    assert PYTHONS[0] == lowest
    assert set(named) <= set(PYTHONS)


def test_python_311_and_313_are_among_those_that_are_tried():
    """Where they are at hand: a machine with one Python tries that one."""
    here = f"{sys.version_info.major}.{sys.version_info.minor}"
    assert here in PYTHONS
    assert interpreter(here)
