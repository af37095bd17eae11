"""A bench in another process: exact to the bit, fast enough, and never left hanging or half dead."""

import importlib.util
import os
import pickle
import shutil
import signal
import socket
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ultraquiet._base.errors import BenchError, InputError
from ultraquiet.bench import Bench, Process, Streaming, Wrapped
from ultraquiet.bench.process.protocol import GREETING, number
from ultraquiet.values import StateSpace

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
FLOOR_HZ = 3500.0  # a plant must be driven at least in its own time
RUNS = 20


def twin():
    """The plant of docs/examples in this process."""
    spec = importlib.util.spec_from_file_location("plant", EXAMPLES / "plant.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    plant = module.Plant()
    return lambda channels: Wrapped(
        lambda u, d: plant.step(u.tolist(), d.tolist()), plant.reset, 2000.0, channels.actuators, channels.sensors
    )


@pytest.fixture(scope="session")
def compiled(tmp_path_factory):
    """plant.c as C and, where a compiler is there, as C++."""
    folder = tmp_path_factory.mktemp("plant")
    made = {}
    for name, tool, flags in (("c", "cc", ("-std=c99",)), ("c++", "c++", ("-x", "c++"))):
        if name == "c" or shutil.which(tool):
            out = folder / f"plant-{len(made)}"
            strict = ("-Wall", "-Wextra", "-Werror", "-O2", "-ffp-contract=off")
            subprocess.run([tool, *flags, *strict, "-o", str(out), str(EXAMPLES / "plant.c")], check=True)
            made[name] = str(out)
    return made


@pytest.fixture(params=["python", "c", "c++"])
def command(request, compiled):
    if request.param == "python":
        return (sys.executable, str(EXAMPLES / "plant.py"))
    if request.param not in compiled:
        return (compiled["c"],)
    return (compiled[request.param],)


def law_for(rng):
    return StateSpace([[0.9]], 0.1 * rng.normal(size=(1, 2)), rng.normal(size=(2, 1)), rng.normal(size=(2, 2)), 2000.0)


def test_a_plant_outside_gives_the_record_of_the_plant_inside_to_the_bit(command, rng):
    u, d = rng.normal(size=(2, 2, 700)) * 20.0
    with Process(command) as bench:
        assert isinstance(bench, Bench)
        assert isinstance(bench, Streaming)
        assert [c.name for c in bench.actuators] == ["push 1", "push 2"]
        assert (bench.rate_hz, bench.sensors[0].unit, bench.sensors[0].high) == (2000.0, "m/s", 10.0)
        inside = twin()(bench)
        for law in (None, law_for(rng)):
            theirs, ours = bench.run(u, d, law), inside.run(u, d, law)
            assert np.array_equal(theirs.inputs, ours.inputs)
            assert np.array_equal(theirs.outputs, ours.outputs)
            parts = list(bench.stream(u, d, law, block_samples=97))
            assert np.array_equal(np.concatenate([b.readings for b in parts], axis=1), ours.outputs)
        assert np.ptp(ours.outputs) > 0


@pytest.mark.slow
def test_speed(command, rng):
    """The best of a few runs: what others do on this machine is not the line protocol's affair."""
    u = rng.normal(size=(2, 1000))
    with Process(command) as bench:
        bench.run(u[:, :100])
        for law in (None, law_for(rng)):
            rate = 0.0
            for _ in range(RUNS):
                began = time.perf_counter()
                bench.run(u, controller=law)
                rate = max(rate, u.shape[1] / (time.perf_counter() - began))
                if rate > FLOOR_HZ:
                    break
            print(f"{Path(command[-1]).name}, {'open' if law is None else 'closed'} loop: {rate:.0f} samples/s")
            assert rate > FLOOR_HZ


def test_over_tcp(rng):
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    server = subprocess.Popen([sys.executable, str(EXAMPLES / "plant.py"), str(port)])
    try:
        u = rng.normal(size=(2, 300))
        for _ in range(2):  # the plant outlives its driver
            with Process(port=port, start_timeout_s=20.0) as bench:
                assert np.array_equal(bench.run(u).outputs, twin()(bench).run(u).outputs)
                assert bench.provenance.settings["port"] == port
        server.kill()
        server.wait()
        with pytest.raises(BenchError, match=f"nothing answers on 127.0.0.1, port {port}"):
            Process(port=port, start_timeout_s=0.1).run(u)
    finally:
        server.kill()
        server.wait()


@given(st.floats(allow_nan=False))
@settings(max_examples=300, deadline=None)
def test_numbers_come_back_exact(x):
    for text in (repr(x), x.hex(), f"{x:.17g}"):
        assert np.float64(number(text)).tobytes() == np.float64(x).tobytes()


FAKE = """
import sys, os, time, signal
k = -1
for line in sys.stdin:
    word, *rest = line.split()
    if word == "hello":
        print("ultraquiet-plant 1\\nrate 100\\nactuator V -5 5 force\\nsensor V -inf inf speed\\nahead {ahead}\\nready")
    elif word == "step":
        k += 1
        if k == {at}:
            {act}
        print("y", 2 * (float(rest[0]) + float(rest[1])))
    else:
        print("ok")
    sys.stdout.flush()
"""


def fake(act, at, ahead=1):
    return (sys.executable, "-c", textwrap.dedent(FAKE).format(act=act, at=at, ahead=ahead))


FAULTS = {
    "dies": ("sys.stderr.write('out of magic smoke'); sys.exit(3)", "ended with exit code 3, its last words: 'out of"),
    "is killed by a signal without a name": ("os.kill(os.getpid(), 40)", "was killed by signal 40 without a word"),
    "is killed": ("os.kill(os.getpid(), signal.SIGKILL)", "was killed by SIGKILL without a word"),
    "hangs": ("time.sleep(1000)", "said nothing for 0.5 s"),
    "is deaf to SIGTERM": (
        "signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(1000)",
        "said nothing for 0.5 s",
    ),
    "prints garbage": ("print('\\\\x00hello world')", "must answer 'y' and 1 finite numbers, got '.*hello world'"),
    "prints bytes": ("sys.stdout.buffer.write(bytes(range(128, 256)) + b'\\\\n')", "must answer 'y' and 1 finite"),
    "never ends its line": ("print('y ' + '1' * 3000000, end='')", "bytes without an end of line"),
    "gives too many": ("print('y 1 2')", "1 finite numbers, got 'y 1 2'"),
    "gives none": ("print('y')", "1 finite numbers, got 'y'"),
    "gives NaN": ("print('y nan')", "1 finite numbers, got 'y nan'"),
    "gives inf": ("print('y -inf')", "1 finite numbers, got 'y -inf'"),
    "refuses": ("print('error table is not level')", "refused: table is not level"),
    "hangs up": ("os.close(1); time.sleep(1000)", "closed its output without a word"),
}


@pytest.mark.gate("hangs up-32")
@pytest.mark.parametrize("ahead", [1, 32])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_plant_that_fails_gives_one_sentence_keeps_what_was_measured_and_leaves_nobody_behind(fault, ahead, rng):
    act, words = FAULTS[fault]
    at = int(rng.integers(1, 60))
    u = rng.uniform(-1, 1, (1, 80))
    bench = Process(fake(act, at, ahead), timeout_s=0.5)
    blocks, stream = [], bench.stream(u, block_samples=25)
    pid = bench._connected()[0]._process.pid
    with pytest.raises(BenchError, match=rf"at sample {at} the plant.* {words}") as caught:
        blocks.extend(stream)
    assert "\n" not in str(caught.value)
    readings = np.concatenate([b.readings for b in blocks], axis=1)
    assert np.array_equal(readings, 2 * np.concatenate([[[0.0]], u[:, : at - 1]], axis=1))
    with pytest.raises(ProcessLookupError):  # neither running nor a zombie
        os.kill(pid, 0)
    print(f"{fault} at sample {at}: {readings.shape[1]} samples kept; {caught.value}")


def test_a_plant_that_failed_is_started_afresh(rng):
    bench = Process(fake("sys.exit(1)", 30), timeout_s=5.0)
    with pytest.raises(BenchError, match="at sample 30"):
        bench.run(np.ones((1, 40)))
    with bench:
        assert bench.run(np.ones((1, 20))).outputs[0, -1] == 2.0


HANDSHAKES = [
    ("", "ended with exit code 0"),
    ("ultraquiet-plant 2", "must greet with 'ultraquiet-plant 1', got 'ultraquiet-plant 2'"),
    ("ultraquiet-plant 1\nrate -1", "got -1|above zero"),
    ("ultraquiet-plant 1\nrate fast", "'rate fast', which says nothing known"),
    ("ultraquiet-plant 1\nactuator V 5 -5 a", "low 5 must be below high -5"),
    ("ultraquiet-plant 1\nactuator V 5 6", "a name is missing"),
    ("ultraquiet-plant 1\nready", "must name its rate, an actuator and a sensor"),
    ("ultraquiet-plant 1\nahead 0", "'ahead' must be at least 1"),
    ("error not today", "the plant refused: not today"),
]


@pytest.mark.parametrize(("said", "words"), HANDSHAKES, ids=[h[0][-25:] for h in HANDSHAKES])
def test_a_bad_handshake_is_refused(said, words):
    script = f"print({said!r}); input()" if said else "pass"
    bench = Process((sys.executable, "-c", script), start_timeout_s=10.0)
    with pytest.raises((BenchError, InputError), match=words):
        bench.run([[0.0]])
    assert bench._line.link is None


def test_remarks_and_late_frames(rng):
    script = fake("print('# a library that prints'); print(); print('late 2'); print('late 1')", 7)
    with Process(script) as bench:
        record = bench.run(np.ones((1, 20)))
    assert record.provenance.settings["overruns"] == 3
    assert record.samples == 20


def test_what_cannot_work_is_refused():
    for bad in ({}, {"command": ("a",), "port": 5}):
        with pytest.raises(InputError, match="either 'command'"):
            Process(**bad)
    with pytest.raises(InputError, match="sequence of texts"):
        Process("./plant")
    with pytest.raises(InputError, match="'port' must be between"):
        Process(port=0)
    with pytest.raises(BenchError, match=r"'/no/such/plant' cannot be started"):
        Process(("/no/such/plant",)).run([[0.0]])


def test_one_run_at_a_time_and_closing_early_is_no_harm(rng):
    with Process(fake("pass", 0, 16)) as bench:
        first = bench.stream(np.ones((1, 100)), block_samples=10)
        next(first)
        with pytest.raises(BenchError, match="in the middle of another run"):
            bench.run(np.ones((1, 5)))
        pid = bench._connected()[0]._process.pid
        first.close()
        assert bench.run(np.ones((1, 5))).outputs[0].tolist() == [0.0, 2.0, 2.0, 2.0, 2.0]
        assert bench._connected()[0]._process.pid == pid


class Nervous:
    """A controller that is interrupted in the middle of a block."""

    def reset(self):
        self.k = 0

    def step(self, y):
        self.k += 1
        if self.k == 13:
            raise KeyboardInterrupt
        return np.zeros(1)


def test_an_interrupt_ends_the_run_and_keeps_the_plant(rng):
    with Process(fake("pass", 0)) as bench:
        blocks = []
        with pytest.raises(KeyboardInterrupt):
            blocks.extend(bench.stream(np.ones((1, 50)), controller=Nervous(), block_samples=10))
        assert sum(b.readings.shape[1] for b in blocks) == 12
        assert bench.run(np.ones((1, 3))).samples == 3


def test_a_forgotten_bench_leaves_no_process(rng):
    bench = Process(fake("pass", 0))
    assert bench.rate_hz == 100.0
    pid = bench._connected()[0]._process.pid
    again = pickle.loads(pickle.dumps(bench))
    assert again == bench
    assert again._line.link is None
    del bench
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_driver_that_is_killed_takes_its_plant_along(tmp_path):
    script = (
        "import os, sys, numpy as np; from ultraquiet.bench import Process; "
        f"bench = Process({fake('pass', 0)!r}); "
        "stream = bench.stream(np.ones((1, 10**6)), block_samples=10); next(stream); "
        "print(bench._connected()[0]._process.pid, flush=True); os.kill(os.getpid(), 9)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    pid, until = int(done.stdout), time.monotonic() + 10.0
    while time.monotonic() < until and alive(pid):
        time.sleep(0.02)
    assert not alive(pid)


def alive(pid):
    """True while a process runs; whoever adopted it may take its time to collect it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_list_names_a_process_and_numbers_its_runs(tmp_path):
    from ultraquiet import experiments

    plant = tmp_path / "plant.py"
    plant.write_text(
        fake("pass", 0)[2]
        .replace("    else:\n", '    elif word == "reset":\n        run = float(rest[0]); print("ok")\n    else:\n')
        .replace("2 * (float(rest[0])", "run + 2 * (float(rest[0])")
    )
    listed = experiments.parse(
        f"""
        bench = {{ method = "process", command = ["{sys.executable}", "{plant}"] }}
        [[commands]]
        do = "excite"
        name = "push"
        samples = 300
        signal = {{ method = "step", level_v = 3.0 }}
        [[commands]]
        do = "record"
        name = "quiet"
        samples = 20
        """
    )
    records = experiments.run(listed, tmp_path / "records")
    assert records["push-1"].outputs.max() == 6.0
    assert np.array_equal(records["quiet"].outputs, np.ones((1, 20)))
    listed.bench.close()


TALKERS = {
    "remarks for ever": ("while True: out('# thinking'); time.sleep(0.01)", "said nothing but .* remarks for 0.5 s"),
    "a flood of remarks": ("while True: sys.stdout.write('#\\n' * 20000)", "said nothing but .* remarks for 0.5 s"),
    "late for ever": ("while True: out('late 1'); time.sleep(0.01)", "said nothing but .* remarks for 0.5 s"),
    "late beyond count": ("out('late ' + '9' * 6000)", "must say 'late' and how many"),
    "late in other digits": ("out('late \\u00b2')", "must say 'late' and how many"),
    "late without a count": ("out('late')", "must say 'late' and how many"),
    "numbers with underscores": ("out('y 1_0')", "1 finite numbers"),
    "numbers in other digits": ("out('y \\u0663')", "1 finite numbers"),
    "a long refusal": ("out('error ' + 'x' * 900000)", "the plant refused: x{500}"),
    "commands to the terminal": ("out('error \\x1b]0;owned\\x07')", "refused: .\\]0;owned."),
    "a flood of last words": (
        "[sys.stderr.write('e' * 65536) for _ in range(800)]; sys.exit(1)",
        "last words: 'e{300}'",
    ),
}
HEAD = "ultraquiet-plant 1\\nrate 1000\\nactuator V -5 5 push\\nsensor V -10 10 pull\\nready"


def talker(act):
    return (
        sys.executable,
        "-S",
        "-c",
        "import sys, time\ndef out(text): print(text, flush=True)\nfor line in sys.stdin:\n    word = line.split()[0]\n"
        f"    if word == 'hello': out('{HEAD}')\n    elif word == 'step':\n        {act}\n    else: out('ok')\n",
    )


@pytest.mark.parametrize("what", TALKERS)
def test_a_plant_that_talks_instead_of_answering_is_ended_in_time(what):
    act, words = TALKERS[what]
    bench, begun = Process(talker(act), timeout_s=0.5), time.monotonic()
    with pytest.raises(BenchError, match=words) as caught:
        bench.run([[1.0, 1.0]])
    assert len(str(caught.value)) < 700
    assert "\x1b" not in str(caught.value)
    assert time.monotonic() - begun < 30


def test_a_child_that_a_plant_leaves_is_ended_with_it(tmp_path):
    left = tmp_path / "left"
    act = f"import os; child = os.fork() or time.sleep(600); open({str(left)!r}, 'w').write(str(child)); sys.exit(0)"
    # The child holds the plant's output open, so nothing tells that the plant is gone.
    with pytest.raises(BenchError, match="said nothing"):
        Process(talker(act), timeout_s=1.0).run([[1.0]])
    for _ in range(100):
        if not Path(f"/proc/{left.read_text()}").exists() or _is_zombie(int(left.read_text())):
            break
        time.sleep(0.05)
    else:
        raise AssertionError("the plant's child is still there")


def _is_zombie(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


@pytest.mark.slow
def test_endless_handshakes_end():
    for head, words in (
        ("while True: out('sensor V -1 1 s')", "up to 4096 channels"),
        ("while True: out('# soon')", "said nothing but .* remarks for 3 s"),
        ("out('rate 1_000')", "is no number"),
        ("out('ahead \\u00b2')", "no whole number"),
    ):
        act = f"import sys\ndef out(text): print(text, flush=True)\nsys.stdin.readline()\nout('{GREETING}')\n{head}"
        with pytest.raises(BenchError, match=words):
            Process((sys.executable, "-S", "-c", act), start_timeout_s=3.0).run([[1.0]])


def test_a_plant_on_a_port_obeys_who_knows_its_word(tmp_path, rng):
    (tmp_path / "token").write_text("open-sesame\n")
    (tmp_path / "wrong").write_text("open-barley\n")
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    command = [sys.executable, str(EXAMPLES / "plant.py"), str(port), "127.0.0.1", str(tmp_path / "token")]
    server = subprocess.Popen(command)
    try:
        for file in ("", str(tmp_path / "wrong")):
            with pytest.raises(BenchError, match="the token is missing or another"):
                Process(port=port, start_timeout_s=20.0, token_file=file).run(np.zeros((2, 3)))
        with Process(port=port, start_timeout_s=20.0, token_file=str(tmp_path / "token")) as bench:
            assert bench.run(np.zeros((2, 3))).samples == 3
            assert "open-sesame" not in repr(bench) + bench.provenance.to_json()
    finally:
        server.terminate()
        server.wait()
    for content in ("", "two words", "\xff"):
        (tmp_path / "wrong").write_bytes(content.encode("latin-1"))
        with pytest.raises(InputError, match="token"):
            Process(port=port, token_file=str(tmp_path / "wrong")).run(np.zeros((2, 3)))
