"""One fixture seeds every random draw; a failure prints the seed, `--seed N` repeats it."""

import os
import sys

# Many small problems side by side: threads inside each cost more than they give. Set before NumPy loads its BLAS.
for _library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import numpy as np  # noqa: E402
import pytest  # noqa: E402


def pytest_addoption(parser):
    parser.addoption("--seed", type=int, default=None, help="seed of all random draws; drawn fresh when absent")


def pytest_configure(config):
    if config.getoption("--seed") is None:
        config.option.seed = int(np.random.SeedSequence().entropy % 2**32)


def pytest_report_header(config):
    return f"seed: {config.getoption('--seed')}"


@pytest.fixture
def seed(request):
    """A whole number that differs from run to run."""
    return request.config.getoption("--seed")


@pytest.fixture
def rng(seed):
    """A generator started from the run's seed."""
    return np.random.default_rng(seed)


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Run `ultraquiet WORDS` in `tmp_path`; returns exit code, stdout and stderr."""
    from ultraquiet.cli.app import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")

    def command(*words):
        capsys.readouterr()  # what the test itself has printed
        monkeypatch.setattr(sys, "argv", ["ultraquiet", *map(str, words)])
        try:
            main()
        except SystemExit as stop:
            return stop.code or 0, *capsys.readouterr()
        return 0, *capsys.readouterr()

    return command
