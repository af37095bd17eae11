"""Fixed draws for the gate and fresh ones on request, one thread a process, and what many tests share."""

import fcntl
import gc
import json
import os
import re
import signal
import sys

# Many small problems side by side: threads inside each cost more than they give. Set before NumPy loads its BLAS.
for _library in ("OPENBLAS", "MKL", "OMP", "NUMBA"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
# A shell's background job ignores Ctrl-C and so would every program that a test starts and interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

import hypothesis  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis.internal.conjecture import providers  # noqa: E402

GATE_SEEDS = (1, 2, 3)
FRESH_DRAWS = 5  # of `make test-fresh`, which share the cases of a long campaign
# Where three draws cost little: all three of the gate's seeds; elsewhere the first, and `make test-fresh` for more.
THREE_DRAWS = (
    "tests/architecture/",
    "tests/base/",
    "tests/identify/test_kernels_twins.py",
    "tests/identify/test_slicot_ib01.py",
    "tests/linalg/",
    "tests/plot/",
    "tests/signals/",
    "tests/values/",
)
# Of the packaged study: the law that the requirements name, and models that take seconds; the long run has all.
GATE_LAWS, GATE_STRUCTURES = ("quiet",), ("arx", "output-error")
# Folders whose set-up is the longest: their tests come first, so that no worker is left alone with them at the end.
FIRST = ("tests/pipeline/", "tests/report/")

# Collecting makes some millions of objects that live as long as the process. To look for rubbish among them, while they
# are made and ever after, took a sixth of the run: nothing is looked for until they are there, and they are left out.
gc.disable()

hypothesis.settings.register_profile("gate", derandomize=True, database=None, deadline=None)
hypothesis.settings.register_profile("fresh", derandomize=False, database=None, deadline=None, print_blob=True)


def pytest_addoption(parser):
    parser.addoption("--seed", type=int, default=None, help="seed of every random draw instead of the gate's 1, 2, 3")
    parser.addoption("--live-seconds", type=float, default=60.0, help="how long a live bench is watched")
    parser.addoption("--whole", action="store_true", help="campaigns strike every place instead of a drawn share")
    parser.addoption("--drawing", action="store_true", help="only the tests that draw")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    seed = config.getoption("--seed")
    hypothesis.settings.load_profile("gate" if seed is None else "fresh")
    if seed is None:
        # Constants of whatever modules are loaded are drawn too: which they are hangs on the tests that ran before.
        providers._get_local_constants = lambda: providers._local_constants
    else:
        config.option.hypothesis_seed = seed


def pytest_report_header(config):
    seed = config.getoption("--seed")
    return f"seeds: {', '.join(map(str, GATE_SEEDS))}" if seed is None else f"seed: {seed}"


def pytest_generate_tests(metafunc):
    """A test that draws runs on seed 1, where that costs little on 2 and 3 too; with `--seed N` on N alone."""
    if "seed" not in metafunc.fixturenames:
        return
    asked = metafunc.config.getoption("--seed")
    if asked is not None:
        metafunc.parametrize("seed", [asked], ids=["drawn"])
        return
    test = metafunc.definition
    cheap = test.nodeid.startswith(THREE_DRAWS) or test.get_closest_marker("three_draws")
    seeds = GATE_SEEDS if cheap and not test.get_closest_marker("slow") else GATE_SEEDS[:1]
    metafunc.parametrize("seed", seeds, ids=[f"seed{seed}" for seed in seeds])


def draws(item) -> bool:
    """Whether what the test does depends on the seed."""
    drawn = {"seed", "first_seed"} & set(getattr(item, "fixturenames", ()))
    return bool(drawn) or getattr(getattr(item, "obj", None), "is_hypothesis_test", False)


def leave_cases_for_the_long_run(items, whole):
    """Mark slow what `gate(...)` does not name of a test's cases; `make test-long` runs them all.

    Where cases are asked for one by one, the one that is named may be missing.
    """
    kept, left = set(), set()
    for item in items:
        mark = item.get_closest_marker("gate")
        if mark is None:
            continue
        case = "-".join(part for part in item.callspec.id.split("-") if not re.fullmatch(r"seed\d+|drawn", part))
        if case in mark.args:
            kept.add(item.function)
        else:
            left.add(item.function)
            item.add_marker(pytest.mark.slow)
    if whole and (nothing := left - kept):
        names = ", ".join(sorted(function.__qualname__ for function in nothing))
        raise pytest.UsageError(f"'gate' names none of the cases of {names}")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Leave out what does not draw when asked to, say in the results what repeats a test, put long set-up first."""
    if config.getoption("--drawing"):
        config.hook.pytest_deselected(items=[item for item in items if not draws(item)])
        items[:] = [item for item in items if draws(item)]
    leave_cases_for_the_long_run(items, not any("::" in arg for arg in config.args))
    for item in items:
        if "demo" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.demo)
        item.user_properties.append(("nodeid", item.nodeid))
        if mark := item.get_closest_marker("draws"):
            item.user_properties.append(("false_alarm", mark.kwargs["false_alarm"]))
    items.sort(key=lambda item: not item.nodeid.startswith(FIRST))


def pytest_collection_finish():
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)
    gc.enable()


def pytest_terminal_summary(terminalreporter, config):
    """After draws that were asked for, one command for each failure that repeats it."""
    seed = config.getoption("--seed")
    failed = [r.nodeid for kind in ("failed", "error") for r in terminalreporter.getreports(kind)]
    if seed is not None and failed:
        terminalreporter.section("to repeat a failure")
        for name in dict.fromkeys(failed):
            terminalreporter.write_line(f"python -m pytest '{name}' --seed {seed}")


@pytest.fixture
def seed():
    """A whole number from which the test draws; `pytest_generate_tests` gives it."""
    raise AssertionError("'seed' is asked for by name in the test or in a fixture of one test")


@pytest.fixture
def rng(seed):
    """A generator started from the seed."""
    return np.random.default_rng(seed)


@pytest.fixture(scope="session")
def first_seed(request):
    """The seed of what many tests share: the gate's first, or the one that was asked for."""
    asked = request.config.getoption("--seed")
    return GATE_SEEDS[0] if asked is None else asked


@pytest.fixture(scope="session")
def share(request):
    """`share(places, most)`: so many of a campaign's places, drawn from the run's seed; all of them with `--whole`."""
    config = request.config

    def drawn(places, most):
        places, asked = list(places), config.getoption("--seed")
        if config.getoption("--whole") or len(places) <= most:
            return places
        rng = np.random.default_rng(GATE_SEEDS[0] if asked is None else asked)
        return [places[k] for k in np.sort(rng.choice(len(places), most, replace=False))]

    return drawn


@pytest.fixture(scope="session")
def cases(request):
    """`cases(n)`: all n of a campaign that draws them alike, of a fresh seed a fifth unless `--whole` is asked for.

    So the five draws of `make test-fresh` take n fresh cases together, and a stated rate is that of a fifth. A campaign
    of no more cases than draws is taken whole.
    """
    config = request.config
    fresh = config.getoption("--seed") is not None and not config.getoption("--whole")
    return lambda n: -(-n // FRESH_DRAWS) if fresh and n > FRESH_DRAWS else n


@pytest.fixture(scope="session")
def demo(request, tmp_path_factory, first_seed):
    """The embedded study in its quick form, once through: its folder, summary, what it said.

    A run without slow tests has one of its laws and short sweeps, any other all of them.
    Workers side by side share one folder: the first walks, the others wait. Tests that walk it further do so in a copy.
    """
    from ultraquiet.pipeline import packaged_study, quick_study, walk

    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / f"demo-{first_seed}"
    words = folder / "said.json"
    with open(folder.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not words.exists():
            said = []
            study = packaged_study("suite")
            head = study.study.model_copy(update={"seed": first_seed})
            study = quick_study(study.model_copy(update={"study": head}))
            if "not slow" in request.config.getoption("markexpr"):
                some = {name: study.controllers[name] for name in GATE_LAWS}
                sweep = study.identify.model_copy(update={"structures": list(GATE_STRUCTURES)})
                study = study.model_copy(update={"controllers": some, "identify": sweep})
            walk(study, folder, say=said.append)
            words.write_text(json.dumps(said))
    summary = json.loads((folder / "summary.json").read_text(), parse_constant=pytest.fail)
    return folder, summary, json.loads(words.read_text())


@pytest.fixture(scope="module")
def browser():
    """The system's Chromium, one for the tests of a module."""
    from chromium import chromium_started

    with chromium_started() as chromium:
        yield chromium


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
