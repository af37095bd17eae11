"""The parts of the workbench's engine: forms, live loops, envelopes, frames, and the door of requests."""

import asyncio
import json
import os
import re
import signal
import time

import numpy as np
import pytest

from ultraquiet import analyse
from ultraquiet._base import registry
from ultraquiet._base.errors import ToolError
from ultraquiet.chart.spec import Axis, Chart, ChartPanel, Curve
from ultraquiet.cli.workbench import command
from ultraquiet.values import Channel, StateSpace
from ultraquiet.workbench.engine.forms import entered, settings_of
from ultraquiet.workbench.engine.live import Notched, attenuation_db, live_loop, responses
from ultraquiet.workbench.figures.traces import envelope
from ultraquiet.workbench.jobs.board import Jobs
from ultraquiet.workbench.jobs.lane import WorkItem
from ultraquiet.workbench.web.frames import packed
from ultraquiet.workbench.web.guard import RequestGuard
from ultraquiet.workbench.web.method_form import FEW
from ultraquiet.workbench.web.pages.reduce import hankel_values

METHODS = [
    (family, name) for family in ("signals", "identify", "design", "reduce") for name in registry.methods(family)
]


@pytest.mark.parametrize(("family", "method"), METHODS, ids=lambda word: word)
def test_every_method_has_a_form_whose_defaults_it_takes(family, method):
    settings = settings_of(family, method)
    assert len({one.name for one in settings}) == len(settings)
    assert entered(family, method, {}) == ({"method": method}, {})
    for one in settings:
        assert one.kind != "choice" or one.default in one.choices
        assert one.label


SIZED = [m for m in METHODS if {"order", "states"} & {one.name for one in settings_of(*m)}]


@pytest.mark.parametrize(("family", "method"), SIZED, ids=lambda word: word)
def test_how_many_states_a_method_makes_is_asked_for_at_once(family, method):
    """Whatever else its annotation allows: the order is what is entered most, not one of the settings folded away."""
    first = [one.name for one in settings_of(family, method)[:FEW]]
    assert {"order", "states"} & set(first), first


@pytest.mark.parametrize(("family", "method"), METHODS, ids=lambda word: word)
def test_no_two_fields_of_a_form_have_one_name(family, method):
    labels = ["method", *(one.label for one in settings_of(family, method))]
    assert len(set(labels)) == len(labels)


@pytest.mark.parametrize(("family", "method"), METHODS, ids=lambda word: word)
def test_what_a_form_says_of_its_fields_is_no_word_of_the_program(family, method):
    """Nobody can write None into a field, nor look up what stands between accents in Python."""
    for one in settings_of(family, method):
        assert not re.search(r"\bNone\b|`", one.meaning), one.meaning


def test_a_form_says_what_it_means_and_what_it_takes():
    form = {one.name: one for one in settings_of("design", "mixed-sensitivity")}
    assert form["disk_margin"].allowed == "between 0 and 2"
    assert form["form"].choices == ("four-block", "skst", "sks", "paper")
    assert form["band_hz"].unit == "Hz"
    assert "corners of the band" in form["band_hz"].meaning
    assert entered("design", "mixed-sensitivity", {"band_hz": "9, 108.5"})[0]["band_hz"] == [9, 108.5]
    _, faults = entered("identify", "box-jenkins", {"order": "-3"})
    assert list(faults) == ["order"]
    assert "between 1 and 30" in faults["order"]


def plant_and_law(ny: int, nu: int, scale: float, units: tuple[str, ...] = ("V",)) -> tuple[StateSpace, StateSpace]:
    """A damped plant and a small law that keeps the loop stable."""
    n = ny + nu
    draws = np.random.default_rng(ny + 10 * nu)
    turn = np.linalg.qr(draws.standard_normal((n, n)))[0]
    A = turn @ np.diag(np.linspace(0.3, 0.95, n)) @ turn.T
    B, C = draws.standard_normal((n, nu)), draws.standard_normal((ny, n))
    sensors = [Channel(f"y{k}", units[k % len(units)]) for k in range(ny)]
    actuators = [Channel(f"u{k}") for k in range(nu)]
    G = StateSpace(A, B, scale * C, np.zeros((ny, nu)), 100.0, actuators=actuators, sensors=sensors)
    gain = -0.05 * np.linalg.pinv(C @ np.linalg.solve(np.eye(n) - A, B)) / scale
    K = StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), gain, 100.0)
    return G, K


@pytest.mark.parametrize(("ny", "nu", "scale"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_what_is_seen_live_is_what_an_analysis_finds(ny, nu, scale):
    G, K = plant_and_law(ny, nu, scale)
    known = responses(G, K)
    loop = live_loop(known.G, known.K, known.f_hz)
    assert loop.peak_db <= analyse.peak_sensitivity(G, K)[0] + 0.01 or ny > nu
    assert attenuation_db(loop, (1.0, 5.0)) == pytest.approx(analyse.band_attenuation(G, K, (1.0, 5.0))[0], abs=0.05)
    for end in ("input", "output"):
        exact = analyse.end_margins(G, K, end)
        assert loop.disk[end] <= exact.disk_all * 1.02, "it is stated from below"
        assert np.allclose(loop.channels[end], exact.disk, rtol=0.02)


def test_a_gain_turned_by_hand_is_the_gain_of_the_law():
    G, K = plant_and_law(2, 2, 1.0)
    louder = StateSpace(K.A, K.B, K.C, 2 * K.D, 100.0)
    known, twice = responses(G, K), responses(G, louder)
    turned = live_loop(known.G, known.K, known.f_hz, Notched(gain_db=20 * np.log10(2)))
    assert np.allclose(turned.S, live_loop(twice.G, twice.K, twice.f_hz).S)
    notch = Notched(notches=[(10.0, 0.3, 40.0)]).response(np.array([0.01, 10.0]))
    assert np.allclose(20 * np.log10(np.abs(notch)), [0.0, -40.0], atol=0.01)


def test_no_extreme_is_lost_between_two_pixels(seed):
    signals = np.random.default_rng(seed).standard_normal((3, 100_000))
    places, shown = envelope(signals, 500)
    assert shown.shape == (3, 1000)
    assert np.all(np.diff(places) > 0)
    assert np.array_equal(shown.max(axis=1), signals.max(axis=1))
    assert np.array_equal(shown.min(axis=1), signals.min(axis=1))


def test_a_frame_holds_its_arrays_aligned_and_once():
    x = np.arange(7.0)
    curves = [Curve(name, x, y) for name, y in (("a", x**2), ("b", x**3))]
    frame = packed(Chart("t", "title with an ä", "", [ChartPanel(Axis("x"), Axis("y"), curves)]))
    size = int.from_bytes(frame[:4], "little")
    head = json.loads(frame[4 : 4 + size])
    assert (4 + size) % 4 == 0
    assert [count for _, count in head["arrays"]] == [7, 7, 7]
    assert np.array_equal(np.frombuffer(frame[4 + size :], "<f4").reshape(3, 7)[1], x**2)


def let_through(kind: str, headers: dict[str, str], query: str = "") -> bool:
    """Whether the guard passes a request on."""
    passed = []

    async def inner(scope, receive, send):
        passed.append(scope)

    async def receive():
        return {"type": "websocket.connect"}

    async def send(message):
        assert message.get("status") != 200

    scope = {
        "type": kind,
        "query_string": query.encode(),
        "headers": [(key.encode(), value.encode()) for key, value in headers.items()],
    }
    asyncio.run(RequestGuard(inner, 8000, "right")(scope, receive, send))
    return bool(passed)


HOST = {"host": "127.0.0.1:8000"}
COOKIE = {"cookie": "ultraquiet-8000=right"}


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    ("headers", "query", "passes"),
    [
        (HOST, "token=right", True),
        ({"host": "localhost:8000", **COOKIE}, "", True),
        ({**HOST, **COOKIE, "origin": "http://127.0.0.1:8000"}, "", True),
        (HOST, "", False),
        (HOST, "token=wrong", False),
        (HOST, "token=right&token=right", False),
        ({**HOST, "cookie": "ultraquiet-8001=right"}, "", False),
        ({**HOST, **COOKIE, "origin": "http://evil.example"}, "", False),
        ({**HOST, **COOKIE, "origin": "null"}, "", False),
        ({"host": "evil.example", **COOKIE}, "", False),
        ({"host": "127.0.0.1:80", **COOKIE}, "", False),
        (COOKIE, "", False),
        ({**HOST, **COOKIE, "sec-fetch-site": "cross-site"}, "", False),
    ],
)
def test_who_may_pass(kind, headers, query, passes):
    assert let_through(kind, headers, query) is passes


class _Still:
    """A session without a study, for work that asks for nothing of it."""

    def __init__(self, folder):
        self.folder, self.state = folder, {"tables": {}}
        (folder / "workbench").mkdir()


@pytest.mark.slow
def test_a_killed_process_fails_its_work_and_the_next_goes_on(tmp_path):
    jobs = Jobs(_Still(tmp_path))
    try:
        first = jobs.submit(WorkItem("look over", "look", {}, {"file": "x.csv"}))
        while jobs.pid() is None:
            time.sleep(0.01)
        os.kill(jobs.pid(), signal.SIGKILL)
        while not first.over:
            time.sleep(0.01)
        assert first.status == "failed"
        assert "killed (SIGKILL); the study is intact" in first.sentence
        second = jobs.submit(WorkItem("look over", "look", {}, {"file": "../x.csv"}))
        while not second.over:
            time.sleep(0.05)
        assert "not in the study's folder" in second.sentence
    finally:
        jobs.close()


def test_without_its_package_a_sentence_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(command.util, "find_spec", lambda name: None)
    with pytest.raises(ToolError, match=r"pip install 'ultraquiet\[workbench\]'"):
        command.serve(tmp_path / "study")
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize("unit", [1.0, 1e4, 1e9])
def test_hankel_values_of_a_law_that_integrates_are_those_of_its_stable_part(unit):
    """Two coupled modes beside an integrator, one position and its speed in other units."""
    A = np.zeros((5, 5))
    A[:4, :4] = [[0, 1.0, 0, 0], [-400, -0.8, 100, 0], [0, 0, 0, 1], [50, 0, -2500, -3.0]]
    B, C = np.array([[0], [1.0], [0], [2.0], [1.0]]), np.array([[100.0, 0, 30, 0, 1.0]])
    alone = hankel_values(StateSpace(A[:4, :4], B[:4], C[:, :4], [[0.0]]))
    d = np.array([unit, 1 / unit, 1.0, 1.0, 1.0])
    found = hankel_values(StateSpace(A * d / d[:, None], B / d[:, None], C * d, [[0.0]]))
    np.testing.assert_allclose(found, alone, rtol=1e-6)
    assert alone.size == 4
    sampled = StateSpace(np.diag([1.0, 0.5]), [[1.0], [1.0]], [[0.1, 0.01]], [[0.0]], 100.0)
    np.testing.assert_allclose(hankel_values(sampled), [0.01 / 0.75])
