"""Every mistake of a list is told at once, each with its line, before anything moves."""

import re
import tomllib

import pytest

from ultraquiet import experiments, files
from ultraquiet._base.errors import InputError
from ultraquiet._base.lines import line_numbers, line_of
from ultraquiet.values import Record, StateSpace

BENCH = '[bench]\nmethod = "hexapod"\n'


def told(text, **kwargs):
    with pytest.raises(experiments.ListError) as caught:
        experiments.parse(text, **kwargs)
    assert isinstance(caught.value, InputError)
    return dict(caught.value.mistakes)


def test_all_mistakes_at_once_with_their_lines():
    text = """\
title = "wrong in many ways"
speed = 3
[bench]
method = "hexapod"
colour = "red"

[[commands]]
do = "jump"

[[commands]]
do = "excite"
name = "too loud"
signal = { method = "tone", frequency_hz = 60.0, amplitude_v = nan }

[[commands]]
do = "excite"
name = "b"
actuator = 0
signal = { method = "sawtooth" }

[[commands]]
do = "excite"
name = "c"
samples = 12.5
signal = { method = "tone", frequenzy_hz = 60.0 }

[[commands]]
name = "d"

[[commands]]
do = "repeat"
times = 0
commands = [
  { do = "wait", seconds = -1.0 },
  { do = "excite", name = "e", signal = { method = "chirp", stop_hz = "$top" } },
  { do = "controller-on", file = "nowhere.h5" },
]

[[commands]]
do = "disturbance-off"
"""
    mistakes = told(text)
    print(mistakes)
    expected = {
        2: "no key 'speed'",
        5: "has no setting 'colour'",
        8: "no command 'jump'",
        12: "'name' is 'too loud'",
        13: "'amplitude_v' must be finite",
        18: "'actuator' is 0",
        19: "no method 'sawtooth'",
        24: "'samples'",
        25: "has no setting 'frequenzy_hz'",
        27: "'do' is missing",
        32: "'times'",
        34: "'seconds'",
        35: "no variable 'top'",
        36: "nowhere.h5' cannot be read",
        39: "no disturbance is on",
    }
    for line, words in expected.items():
        assert words in mistakes[line], (line, mistakes)
    assert set(mistakes) == set(expected), mistakes


def test_signal_mistakes_with_their_lines():
    text = (
        BENCH
        + """\
[[commands]]
do = "excite"
name = "a"
signal = { method = "sawtooth" }
[[commands]]
do = "excite"
name = "b"
[commands.signal]
method = "tone"
frequenzy_hz = 60.0
[[commands]]
do = "excite"
name = "c"
signal = { method = "tone", frequency_hz = 60.0, amplitude_v = 30.0 }
[[commands]]
do = "excite"
name = "d"
actuator = [2, 9]
signal = { method = "tone", frequency_hz = 2000.0 }
[[commands]]
do = "configure"
limit_v = 5.0
[[commands]]
do = "excite"
name = "C"
signal = { method = "step", level_v = 10.0 }
"""
    )
    with pytest.raises(experiments.ListError) as caught:
        experiments.parse(text)
    message = str(caught.value)
    print(message)
    for words in (
        r"line 6: signals: there is no method 'sawtooth'",
        r"line 12: signals 'tone' has no setting 'frequenzy_hz'",
        r"line 16: the signal spans -29.9988 to 29.9988 V, beyond the limits of 'strut 1', -25 to 25; lower it",
        r"line 20: there is no actuator 9; the bench has 1 to 6",
        r"line 21: Tone: 'frequency_hz' of 2000 Hz must lie below half the sampling rate",
        r"line 27: 'C' names records that line 13 leaves already",
        r"line 28: the signal spans 0 to 10 V, beyond the list's own limit, -5 to 5",
    ):
        assert re.search(words, message), words


def test_a_missing_bench_is_told_with_the_rest_and_by_run(tmp_path):
    sound = '[[commands]]\ndo = "record"\nname = "quiet"\n'
    assert "there is no bench" in told(sound + "[[commands]]\ndo = 3\n")[1]
    listed = experiments.parse(sound)
    with pytest.raises(InputError, match="there is no bench"):
        experiments.run(listed, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("a = \n", 1, "not TOML"),
        ("title = 3\n" + BENCH + '[[commands]]\ndo = "record"\nname = "a"\n', 1, "'title'"),
        (BENCH, 1, "'commands' is missing"),
        (BENCH + "commands = 3\n", 3, "has no setting 'commands'"),
        ("commands = 3\n" + BENCH, 1, "'commands'"),
        (BENCH + '[[commands]]\ndo = "wait"\nseconds = 1\n', 1, "no command records anything"),
        ('[bench]\nmethod = "centrifuge"\n[[commands]]\ndo = "record"\nname = "a"\n', 2, "no method 'centrifuge'"),
        ('[bench]\nmethod = "hexapod"\nunit = "lunar"\n[[commands]]\ndo = "record"\nname = "a"\n', 3, "'lunar'"),
        ('[bench]\nmethod = "wrapped"\n[[commands]]\ndo = "record"\nname = "a"\n', 1, "lacks its setting 'step'"),
        (BENCH + '[[commands]]\ndo = "controller-off"\n', 3, "no controller is on"),
        (BENCH + '[[commands]]\ndo = "set"\n"a b" = 1\n', 5, "cannot be set"),
        ("commands = [3]\n" + BENCH, 1, "valid dictionary"),
        (BENCH + '[[commands]]\ndo = "record"\nname = "../x"\n', 5, "only letters"),
    ],
)
def test_single_mistakes(text, line, words):
    mistakes = told(text)
    assert words in mistakes.get(line, ""), mistakes


def test_controllers_must_fit_the_bench(tmp_path, rng):
    gain = rng.standard_normal((6, 6))

    def law(D, rate_hz):
        return StateSpace([[0.5]], [[0.0] * D.shape[1]], [[0.0]] * D.shape[0], D, rate_hz)

    files.save(law(gain[:5], 3500.0), tmp_path / "small.h5")
    files.save(law(gain, 3000.0), tmp_path / "slow.h5")
    files.save(law(gain, None), tmp_path / "continuous.h5")
    files.save(Record(gain, gain, 3500.0), tmp_path / "record.h5")
    names = ("small", "slow", "continuous", "record")
    commands = "".join(f'[[commands]]\ndo = "controller-on"\nfile = "{n}.h5"\n' for n in names)
    mistakes = told(BENCH + commands, folder=tmp_path)
    assert "has (commands, readings) (5, 6), the bench (6, 6)" in mistakes[5]
    assert "runs at 3000 Hz, the bench at 3500 Hz" in mistakes[8]
    assert "discrete time" in mistakes[11]
    assert "holds a Record" in mistakes[14]


def flat(value, place=()):
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, held in items:
        yield (*place, key)
        yield from flat(held, (*place, key))


TOML = '''\
# a remark with [brackets] and "quotes
title = "a # no remark = [1]"
'quoted key' = 1
dotted.key.deep = 2
dotted.key."other one" = 3
text = """first
  second = [ "no key" ]
[not.a.table]
"""
raw = \'\'\'it's
[[nor this]]\'\'\'
numbers = [
  1, # one
  [2, 3],
  { x = 4, y = [5,
    6] },
]
when = 1979-05-27T07:32:00Z
[bench]
method = "hexapod"   # remark
[bench.inner."a.b"]
k = { a = 1, b = { c = 2 } }
[[commands]]
do = "x"
[commands.signal]
method = "tone"
[[commands]]
do = "repeat"
[[commands.commands]]
do = "p"
[[commands.commands]]
do = "q"
[commands.commands.signal]
method = "deep"
[[commands]]
do = "last"
'''


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_lines_of_every_key_of_a_text(ends):
    text = TOML.replace("\n", ends)
    places, lines = line_numbers(text), TOML.splitlines()
    keys = list(flat(tomllib.loads(text)))
    assert set(places) == set(keys)
    for place in keys:
        if isinstance(place[-1], str):
            assert place[-1] in lines[places[place] - 1], place
    assert lines[places["commands", 1, "commands", 1, "signal", "method"] - 1] == 'method = "deep"'
    assert lines[places["commands", 2, "do"] - 1] == 'do = "last"'
    assert places["numbers", 2, "y", 1] == 16
    assert line_of(places, ("commands", 0, "absent", 3)) == places["commands", 0]
    assert line_of(places, ("absent",)) == 1
