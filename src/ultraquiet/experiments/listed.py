"""Experiment lists: read from TOML, checked whole, ready to run."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ultraquiet._base.errors import InputError
from ultraquiet._base.mistakes import Mistakes, read_toml
from ultraquiet._base.provenance import content_hash
from ultraquiet._base.regular import read_regular_text
from ultraquiet.bench import Process
from ultraquiet.experiments.command import Content
from ultraquiet.experiments.compile import Compiler
from ultraquiet.experiments.making import checked_bench, make
from ultraquiet.experiments.mistakes import ListError
from ultraquiet.experiments.plan import Measurement, Step, duration_s
from ultraquiet.files import reason, refuse_data

PACKAGED = ("suite",)
STARTED_WHEN_ASKED = (Process,)
NO_BENCH = 'there is no bench; name one in a table [bench], as in method = "hexapod", or give one to run.'


@dataclass(frozen=True, eq=False)
class ExperimentList:
    """A checked list: its text, the bench it names (or None) and the plan it comes to on that bench.

    `steps` are measurements and pauses in order; they are empty as long as no bench is known. `seed` is one given
    instead of the list's own. `said` are sentences on what was settled that the list leaves open.
    """

    name: str
    title: str
    text: str
    folder: Path | None
    bench: Any | None
    steps: tuple[Step, ...]
    seed: int | None = None
    said: tuple[str, ...] = ()

    @property
    def measurements(self) -> tuple[Measurement, ...]:
        """The measurements in order; each leaves one record."""
        return tuple(step for step in self.steps if isinstance(step, Measurement))

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """Name given in the list -> names of its records, one per actuator and round."""
        names: dict[str, tuple[str, ...]] = {}
        for m in self.measurements:
            names[m.group] = (*names.get(m.group, ()), m.name)
        return names

    @property
    def duration_s(self) -> float:
        """Time on the bench in seconds: samples and pauses, without what lies between runs."""
        return 0.0 if self.bench is None else duration_s(self.steps, self.bench.rate_hz)

    @property
    def hash(self) -> str:
        """Content hash of the text and of a seed given instead of its own."""
        return content_hash(self.text) if self.seed is None else content_hash(self.text, self.seed)

    def on(self, bench: Any) -> "ExperimentList":
        """Return the list planned for another bench; mistakes are raised as by `parse`."""
        return parse(self.text, bench, self.name, self.folder, self.seed)


def load(path: str | os.PathLike[str], bench: Any | None = None, seed: int | None = None) -> ExperimentList:
    """Read and check an experiment list.

    Args:
        path: a TOML file, or `"suite"` for the packaged list of the paper's test signals. Controllers named in it are
            sought beside it.
        bench: used instead of the list's table `[bench]`.
        seed: where its random signals start, instead of what the list says.

    Raises:
        InputError: the file cannot be read, or holds mistakes; all of them are told, each with its line.

    >>> suite = load("suite")
    >>> suite.groups["tone"], suite.groups["chirp"][:2]
    (('tone',), ('chirp-1', 'chirp-2'))
    """
    place = Path(path)
    if str(path) in PACKAGED and not place.is_file():
        place = Path(__file__).with_name(f"{path}.toml")
    refuse_data("experiment list", place, "a list of commands (TOML)")
    try:
        text = read_regular_text(place)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"experiment list: '{path}' cannot be read ({reason(error)}).") from error
    return parse(text, bench, str(path), place.parent, seed)


def parse(
    text: str,
    bench: Any | None = None,
    name: str = "experiment list",
    folder: Path | None = None,
    seed: int | None = None,
) -> ExperimentList:
    """Check the text of an experiment list; arguments and errors as in `load`.

    >>> parse('''
    ... [bench]
    ... method = "hexapod"
    ... [[commands]]
    ... do = "excite"
    ... name = "loud"
    ... signal = { method = "tone", frequency_hz = 60.0 }
    ... actuator = 7
    ... ''')
    Traceback (most recent call last):
    ultraquiet.experiments.mistakes.ListError: experiment list: one mistake; nothing was executed.
      line 8: there is no actuator 7; the bench has 1 to 6 (strut 1, strut 2, strut 3, strut 4, strut 5, strut 6).
    """
    content, places = read_toml(text, name, ListError)
    if "study" in content and "commands" not in content:
        raise InputError(
            f"experiment list: '{name}' is a study; `ultraquiet run` takes it, and the list that it names under "
            "[experiment] belongs here."
        )
    mistakes = Mistakes(places)
    head = _head(content, mistakes)
    bench_given = bench is not None
    if bench is None and head.bench is not None:
        bench = make("bench", head.bench, ("bench",), mistakes)
    listed_commands = content.get("commands")
    commands: list[Any] = listed_commands if isinstance(listed_commands, list) else []
    first = head.seed if seed is None else seed
    if isinstance(bench, STARTED_WHEN_ASKED):
        # Its channels cost the start of a program: not for a list that is wrong by itself.
        _compiled(commands, Compiler(None, folder, first, mistakes))
        mistakes.refuse(ListError, name)
    if bench is not None:
        bench = checked_bench(bench, () if bench_given else ("bench",), mistakes)
    compiler = _compiled(commands, Compiler(bench, folder, first, mistakes))
    if not any(isinstance(step, Measurement) for step in compiler.steps) and not len(mistakes):
        mistakes.add((), "no command records anything; it would take an 'excite' or a 'record'.")
    # A bench may still be given to run, so its absence alone is no mistake yet.
    if len(mistakes) and bench is None and "bench" not in content:
        mistakes.add((), NO_BENCH)
    mistakes.refuse(ListError, name)
    steps = () if bench is None else tuple(compiler.steps)
    return ExperimentList(name, head.title, text, folder, bench, steps, seed, compiler.said)


def _compiled(commands: list[Any], compiler: Compiler) -> Compiler:
    compiler.walk(commands, ("commands",))
    compiler.finish()
    return compiler


def _head(content: dict[str, Any], mistakes: Mistakes) -> Content:
    """Return the head of a list; what is wrong in it is noted and left at its default."""
    try:
        return Content.model_validate(content)
    except ValidationError as error:
        mistakes.add_refusal((), error, Content)
        wrong = {refusal["loc"][0] for refusal in error.errors()}
        sound = {k: v for k, v in content.items() if k not in wrong and k in Content.model_fields}
        return Content.model_validate({"commands": [None], **sound})
