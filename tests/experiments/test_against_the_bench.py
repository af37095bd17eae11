"""What only the bench can tell is told before it moves: limits, sums, times, names, thermometer, duration."""

import re

import numpy as np
import pytest
from fakes import Fake

from ultraquiet import experiments
from ultraquiet._base.errors import InputError
from ultraquiet.values import Channel


class Warm(Fake):
    """A fake with proof masses and a thermometer that notes when it is asked."""

    actuators = (*Fake.actuators, Channel("base proof mass", "V", -5.0, 5.0))
    gain = np.array([[1.0, 0.0, 0.1], [0.0, 2.0, 0.1], [0.5, 0.5, 0.1]])

    def __init__(self):
        super().__init__()
        self.read = 0

    @property
    def temperature_c(self):
        self.read += 1
        return 20.0 + self.read


@pytest.fixture
def bench():
    return Warm()


def command(do, **keys):
    lines = "\n".join(f"{key} = {value}" for key, value in keys.items())
    return f'[[commands]]\ndo = "{do}"\n{lines}\n'


def quoted(text):
    return f'"{text}"'


def tone(volts, frequency_hz=60.0):
    return f'{{ method = "tone", frequency_hz = {frequency_hz}, amplitude_v = {volts} }}'


def excite(name="push", actuator=1, **keys):
    return command("excite", name=quoted(name), actuator=actuator, **keys)


def told(text, bench):
    with pytest.raises(experiments.ListError) as caught:
        experiments.parse(text, bench)
    print(caught.value)
    assert not bench.calls
    assert not getattr(bench, "read", 0)
    return caught.value.mistakes


STEP = '{ method = "step", level_v = 1.0, rise_s = 0.1, fall_s = 0.5 }'
SINES = '{ method = "multisine", start_hz = 5.0, stop_hz = 50.0, period_samples = 500, peak_v = 2.0 }'
DISTURBED = command("disturbance-on", actuator='"b"', signal=tone(15.0))

# One mistake each: the list, the line on which it stands, words of its sentence.
SINGLE = {
    "amplitude": (
        excite(signal=tone(25.0)) + command("configure", limit_v=20) + excite("x", signal=tone(21)),
        13,
        "beyond",
    ),
    "beyond the channel": (
        excite(actuator='"base proof mass"', signal=tone(6.0)),
        5,
        "limits of 'base proof mass', -5 to 5",
    ),
    "sum with the disturbance": (
        DISTURBED + excite(actuator=2, signal=tone(15.0)),
        9,
        "with the disturbance of line 4",
    ),
    "disturbance alone": (
        command("configure", limit_v=10) + DISTURBED + command("record", name='"quiet"'),
        7,
        "the list's own limit",
    ),
    "disturbance that meets nothing": (
        excite(signal=tone(1)) + command("disturbance-on", signal=tone(1.0, 700.0)),
        8,
        "half the sampling rate",
    ),
    "step beyond the end": (
        excite(samples=300, signal=STEP),
        6,
        "'fall_s' of 0.5 s lies beyond the measurement's end at 0.3 s",
    ),
    "fall before rise": (excite(signal=STEP.replace("0.5", "0.05")), 5, "must come after 'rise_s'"),
    "a longer period": (excite(samples=499, signal=SINES), 6, "'period_samples' of 500 is longer"),
    "Nyquist": (excite(signal=tone(1.0, 501.0)), 5, "half the sampling rate, 500 Hz"),
    "band above Nyquist": (
        excite(signal='{ method = "noise", stop_hz = 600.0 }'),
        5,
        "'stop_hz' of 600 Hz must lie below half",
    ),
    "unknown name": (
        excite(actuator='"c"', signal=tone(1.0)),
        4,
        "no actuator called 'c'; the bench has 1 to 3 (a, b, base",
    ),
    "listed twice": (excite(actuator='[1, "a"]', signal=tone(1.0)), 4, "actuator 1, 'a', is listed twice"),
    "each inside a list": (excite(actuator='["each"]', signal=tone(1.0)), 4, "no actuator called 'each'"),
    "source and actuator": (
        command("disturbance-on", source='"a"', actuator='"b"', signal=tone(1)) + excite(signal=tone(1)),
        3,
        "mean the same",
    ),
    "each as a source": (
        command("disturbance-on", source='"each"', signal=tone(1)) + excite(signal=tone(1)),
        3,
        "'each' is for 'excite'",
    ),
    "too long": (
        command("configure", max_duration_s=5) + command("wait", seconds=2) + excite(signal=tone(1)),
        3,
        "takes 6.1 s",
    ),
    "endless": (
        'commands = [{ do = "repeat", times = 1000, commands = [{ do = "repeat", times = 1000, commands = [\n'
        '{ do = "record", name = "r", samples = 1 } ] } ] }]\n',
        2,
        "more than 100000 commands",
    ),
    "undefined once": (excite(signal='{ method = "tone", frequency_hz = "$f" }', samples=100), 5, "no variable 'f'"),
    "undefined setting of its own": (excite(signal='"$signal"'), 5, "no variable 'signal'"),
    "not a number": (excite(signal=tone("nan")), 5, "finite"),
    "a text for a number": (excite(signal=tone('"loud"')), 5, "amplitude_v"),
    "no actuator": (excite(actuator="[]", signal=tone(1)), 4, "number from 1"),
    "comment": (excite(signal=tone(1), comment=3), 6, "'comment'"),
}


@pytest.mark.parametrize("kind", SINGLE)
def test_one_mistake_is_told_once_where_it_stands(kind, bench):
    text, line, words = SINGLE[kind]
    ((where, sentence),) = told(text, bench)
    assert (where, words in sentence) == (line, True), sentence


def test_a_bench_without_thermometer(tmp_path):
    bench = Fake()
    ((line, sentence),) = told(command("temperature") + excite(signal=tone(1.0)), bench)
    assert (line, sentence) == (1, "Fake has no thermometer; leave 'temperature' out.")


def test_all_kinds_at_once(bench):
    texts, lines, at = [], set(), 0
    for kind, (text, line, _) in SINGLE.items():
        if kind in ("amplitude", "too long", "endless", "disturbance alone", "sum with the disturbance"):
            continue  # these set limits for all that follows, or end the walk
        texts.append(
            text.replace('"push"', f'"n{len(texts)}"') + command("disturbance-off") * ("disturbance-on" in text)
        )
        lines.add(at + line)
        at += texts[-1].count("\n")
    assert {line for line, _ in told("".join(texts), bench)} == lines
    assert len(lines) >= 15


def test_where_excitation_and_disturbance_do_not_add_up_nothing_is_refused(bench):
    """Each 15 V of 25 V: on different actuators, or in opposite phase with the command's sample of delay."""
    later = tone(15.0).replace(" }", f", phase_deg = {180 + 360 * 60 / 1000} }}")
    text = DISTURBED + excite("other", signal=tone(15.0)) + excite("opposite", actuator=2, signal=later)
    assert len(experiments.parse(text, bench).measurements) == 2


def test_each_and_all_leave_proof_masses_alone_and_names_reach_them(bench, tmp_path):
    text = (
        command("disturbance-on", source='"base proof mass"', signal=tone(4.0))
        + excite("each", actuator='"each"', signal=tone(1.0))
        + excite("all", actuator='"all"', signal=tone(1.0))
        + excite("named", actuator='["b", 3]', signal=tone(0.5))
    )
    experiments.run(experiments.parse(text, bench), tmp_path)
    excited = [np.flatnonzero(u.any(axis=1)).tolist() for u, _, _ in bench.calls]
    assert excited == [[0], [1], [0, 1], [1, 2]]
    assert all(np.flatnonzero(d.any(axis=1)).tolist() == [2] for _, d, _ in bench.calls)


def test_temperature_goes_into_later_records_and_the_catalogue(bench, tmp_path):
    text = (
        excite("before", signal=tone(1.0))
        + command("temperature")
        + excite("between", signal=tone(1.0), comment='"door open"')
        + command("temperature", name='"later"')
        + command("record", name='"after"')
        + command("temperature")
    )
    records = experiments.run(experiments.parse(text, bench), tmp_path)
    conditions = {name: r.provenance.settings["conditions"] for name, r in records.items()}
    assert "temperature_c" not in conditions["before"]
    assert conditions["between"]["temperature_c"] == 21.0
    assert conditions["between"]["comment"] == "door open"
    assert conditions["after"]["temperatures_c"] == {"bench": 21.0, "later": 22.0}
    assert bench.read == 2  # nothing is measured after the third
    rows = {e.name: e for e in experiments.find(tmp_path)}
    assert [rows[n].temperature_c for n in ("before", "between", "after")] == [None, 21.0, 22.0]
    assert rows["between"].comment == "door open"
    assert [e.name for e in experiments.search(tmp_path, what="DOOR")] == ["between"]


def test_a_thermometer_that_says_nothing_stops_before_the_next_excitation(bench, tmp_path, monkeypatch):
    monkeypatch.setattr(Warm, "temperature_c", float("nan"))
    text = excite("first", signal=tone(1.0)) + command("temperature") + excite("second", signal=tone(1.0))
    with pytest.raises(InputError, match=re.escape("Warm says nan, which is no number")):
        experiments.run(experiments.parse(text, bench), tmp_path)
    assert len(bench.calls) == 1


def test_a_comment_decides_nothing(bench):
    plain, remarked = (
        experiments.parse(excite(signal=tone(1.0), **keys), bench) for keys in ({}, {"comment": '"rainy"'})
    )
    assert plain.measurements[0].hash == remarked.measurements[0].hash
