"""Whatever a list says: it is refused with lines and nothing moves, or it runs within every limit."""

import json
import math
import tempfile

import numpy as np
from fakes import LIST, Fake
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ultraquiet import experiments
from ultraquiet.experiments.command import VOCABULARY

SAMPLES = 400  # keeps every run short


class Watched(Fake):
    """A fake that checks what it is sent."""

    temperature_c = 21.0

    def run(self, actuation, disturbance=None, controller=None):
        total = actuation.copy()
        if disturbance is not None:
            total[:, 1:] = actuation[:, :-1] + disturbance[:, 1:]
        for sent in (actuation, disturbance, total):
            assert sent is None or (np.isfinite(sent).all() and np.abs(sent).max() <= 25.0)
        return super().run(actuation, disturbance, controller)


def toml(value):
    """Return a value as TOML writes it; texts as JSON does, which TOML reads alike."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value) if isinstance(value, str) else repr(value)


def judged(text):
    """Parse a text; run what is sound, and return whether it was."""
    bench, refusal = Watched(), None
    try:
        listed = experiments.parse(text, bench)
    except experiments.ListError as error:
        refusal = error
    if refusal is not None:
        assert not bench.calls
        assert refusal.mistakes
        lines = max(1, len(text.splitlines()))
        assert all(1 <= line <= lines and sentence for line, sentence in refusal.mistakes), refusal
        return False
    with tempfile.TemporaryDirectory() as folder:
        records = experiments.run(listed, folder, sleep=lambda _: None)
    planned = experiments.dry_run(listed)
    assert len(records) == len(bench.calls) == sum(step.samples > 0 for step in planned.steps)
    assert math.isclose(planned.duration_s, sum(step.lasts_s for step in planned.steps), abs_tol=1e-9)
    return True


anything = st.recursive(
    st.none().map(lambda _: "$x")
    | st.booleans()
    | st.integers(-3, 30)
    | st.integers()
    | st.floats(width=32)
    | st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=5)
    | st.sampled_from(["a", "b", "each", "all", "$top", "$round"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("abc"), inner, max_size=2),
    max_leaves=4,
)
volts = st.floats(-30.0, 30.0)
hertz = st.floats(0.5, 600.0)
signals = st.one_of(
    st.fixed_dictionaries({"method": st.just("tone"), "frequency_hz": hertz, "amplitude_v": volts}),
    st.fixed_dictionaries({"method": st.just("noise"), "stop_hz": hertz, "peak_v": volts}),
    st.fixed_dictionaries({"method": st.just("chirp"), "stop_hz": hertz, "start_v": volts}),
    st.fixed_dictionaries({"method": st.just("prbs"), "stop_hz": hertz, "level_v": volts}),
    st.fixed_dictionaries({"method": st.just("step"), "level_v": volts, "fall_s": st.floats(0.0, 0.6)}),
    st.fixed_dictionaries({"method": st.just("multisine"), "period_samples": st.integers(2, 600), "peak_v": volts}),
    st.dictionaries(st.sampled_from(["method", "stop_hz", "peak_v", "seed"]), anything, max_size=3),
)
names = st.sampled_from(["a", "b", "c", "d", "e", "f", "g", "A", "../x", "tone"])
actuators = st.sampled_from([1, 2, 3, 0, "a", "b", "each", "all", [1, 2], [2, 2], ["a", "b"], [], "z"])
samples = st.integers(1, SAMPLES)
seeds = st.integers(0, 2**40)


def command(do, required=None, **optional):
    return st.fixed_dictionaries({"do": st.just(do), **(required or {})}, optional=optional)


plain = st.one_of(
    command("set", top=volts, x=anything),
    command("configure", samples=samples, seed=seeds, limit_v=st.floats(1.0, 40.0), max_duration_s=st.floats(0.1, 9.0)),
    command("excite", {"name": names, "signal": signals}, actuator=actuators, samples=samples, seed=seeds),
    command("record", {"name": names}, samples=samples, comment=st.just("remark")),
    command("temperature", name=names),
    command("controller-on", {"file": st.sampled_from(["nowhere.h5", "", "\u0000", "."])}),
    command("controller-off"),
    command("disturbance-on", {"signal": signals}, source=actuators, actuator=actuators, seed=seeds),
    command("disturbance-off"),
    command("wait", {"seconds": st.floats(0.0, 3.0)}),
)
spoilt = st.builds(
    lambda given, key, value: {**given, key: value},
    plain,
    st.sampled_from(["do", "name", "signal", "samples", "actuator", "seconds", "times", "commands", "extra"]),
    anything | st.sampled_from(sorted(VOCABULARY)),
)
commands = st.recursive(
    plain | spoilt,
    lambda inner: command("repeat", {"times": st.integers(0, 3), "commands": st.lists(inner, max_size=2)}),
    max_leaves=4,
)
lists = st.fixed_dictionaries(
    {"commands": st.lists(commands, max_size=5)},
    optional={"title": st.text("xyz", max_size=3), "seed": seeds, "extra": anything, "bench": anything},
)
# Most of these are sound: what makes them unsound is how the commands meet.
gentle = st.one_of(
    st.fixed_dictionaries(
        {"method": st.just("tone"), "frequency_hz": st.floats(1, 499), "amplitude_v": st.floats(0, 16)}
    ),
    st.fixed_dictionaries({"method": st.just("noise"), "stop_hz": st.floats(20, 499), "peak_v": st.floats(1, 16)}),
    st.fixed_dictionaries({"method": st.just("step"), "level_v": st.floats(-16, 16), "fall_s": st.floats(0.1, 0.3)}),
)
likely = st.lists(
    st.one_of(
        command("excite", {"signal": gentle}, actuator=st.sampled_from([1, "b", [1, "b"], "each"]), seed=seeds),
        command("record", comment=st.just("remark")),
        command("disturbance-on", {"signal": gentle}, source=st.sampled_from([1, "b", "all"])),
        command("temperature"),
        command("wait", {"seconds": st.floats(0.0, 3.0)}),
    ),
    min_size=1,
    max_size=5,
).map(
    lambda entries: [e | ({"name": f"n{k}"} if e["do"] in ("excite", "record") else {}) for k, e in enumerate(entries)]
)
mostly_sound = st.builds(
    lambda entries, times: {"commands": [{"do": "repeat", "times": times, "commands": entries}]},
    likely,
    st.integers(1, 2),
)
patient = settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))


def written(tables):
    """Return a list as TOML, each command on lines of its own."""
    head = "".join(f"{key} = {toml(value)}\n" for key, value in tables.items() if key != "commands")
    return head + "commands = [\n" + "".join(f"{toml(entry)},\n" for entry in tables["commands"]) + "]\n"


counts = {True: 0, False: 0}


@patient
@given(lists | mostly_sound)
def test_a_list_of_anything_is_refused_whole_or_runs_within_the_limits(tables):
    text = written({"commands": [{"do": "configure", "samples": SAMPLES}, *tables.pop("commands")], **tables})
    counts[judged(text)] += 1


def test_the_fuzz_meets_both_kinds():
    print(f"fuzz: {counts[True]} lists ran, {counts[False]} were refused")
    assert min(counts.values()) >= 5


@patient
@given(st.data())
def test_a_sound_text_that_was_mangled(data):
    """A slice of the text is dropped, doubled, or written over with something else."""
    start = data.draw(st.integers(0, len(LIST)))
    end = data.draw(st.integers(start, min(len(LIST), start + 60)))
    with_what = data.draw(
        st.sampled_from(["", LIST[start:end] * 2, '"', "[", "= 1\n", "\n", "{", "nan", "#", "-1", "'''"])
    )
    judged(LIST[:start] + with_what + LIST[end:])


@patient
@given(st.text(max_size=60) | st.binary(max_size=60).map(lambda b: b.decode("latin-1")))
def test_a_text_of_anything(text):
    judged(text)


def test_a_text_of_ten_thousand_brackets():
    judged("x = " + "[" * 10_000 + "]" * 10_000)
    judged("x = " + "{ a = " * 5_000 + "1" + " }" * 5_000)
    judged("[" + ".".join("a" * 3_000) + "]")
