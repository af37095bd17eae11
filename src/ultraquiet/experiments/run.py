"""Execute a checked list on a bench: one HDF5 record per measurement, none of them ever written over unasked."""

import os
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NoReturn

from ultraquiet._base.progress import Task, task
from ultraquiet.experiments import clock, journal
from ultraquiet.experiments import levels as found_levels
from ultraquiet.experiments.folder import check_space, finished_in, prepared, refuse_repetition, sweep
from ultraquiet.experiments.listed import NO_BENCH, ExperimentList
from ultraquiet.experiments.live import Course, Levels, Onlooker
from ultraquiet.experiments.measure import Measured, Watch, measure, recover
from ultraquiet.experiments.mistakes import ListError
from ultraquiet.experiments.plan import Measurement, Pause, Thermometer
from ultraquiet.experiments.states import ABORTED, DONE, StoppedError, states
from ultraquiet.values import Record


def _never() -> bool:
    return False


def run(
    experiment_list: ExperimentList,
    folder: str | os.PathLike[str],
    bench: Any | None = None,
    *,
    resume: bool = False,
    repeat: Collection[str] = (),
    overwrite: bool = False,
    sleep: Callable[[float], None] | None = None,
    stop: Callable[[], bool] = _never,
    onlooker: Onlooker | None = None,
) -> dict[str, Record]:
    r"""Execute a list in order; each measurement leaves `folder/NAME.h5` before the next one begins.

    Args:
        experiment_list: what `load` or `parse` returned.
        folder: where the records go; made when absent.
        bench: used instead of the one the list names.
        resume: go on where a run was broken off: finished records of this very list are taken from the folder.
        repeat: names of measurements that were begun before, left no record, and shall be excited once more.
        overwrite: write over records that stand in the folder.
        sleep: how to spend a pause in seconds; without it, pauses are waited for on benches in real time (see
            `clock.real_time`) and skipped on simulated ones.
        stop: asked before each block of samples and during pauses; once it says yes, the bench ramps to zero, what was
            measured is kept, and nothing further begins.
        onlooker: who is told of levels and progress.

    Returns:
        Name -> record, in the order of the list.

    Raises:
        InputError: no bench, or mistakes that show only on this bench; nothing has moved then.
        StorageError: records would be written over, an excitation would be repeated unasked, the disk is full, the
            folder is closed; finished records stay.
        StoppedError: `stop` said yes, or the bench ended a run by itself; it says where each measurement stands.

    >>> import tempfile
    >>> from ultraquiet.experiments import parse
    >>> from ultraquiet.bench import Wrapped
    >>> listed = parse(
    ...     '[[commands]]\ndo = "excite"\nname = "push"\nsamples = 300\n'
    ...     'signal = { method = "step", level = 10, fall_s = 0.08 }'
    ... )
    >>> bench = Wrapped(lambda u, d: 2.0 * u, lambda: None, 3500.0, ["force"], ["speed"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     records = run(listed, folder, bench)
    >>> {name: float(record.outputs.max()) for name, record in records.items()}
    {'push-1': 20.0}
    """
    listed = experiment_list if bench is None else experiment_list.on(bench)
    if listed.bench is None:
        raise ListError(listed.name, [(1, NO_BENCH)])
    place = prepared(Path(folder))
    with journal.opened(place) as log:
        recover(place)
        finished = finished_in(listed, place, resume, overwrite)
        if not overwrite:
            refuse_repetition(listed, place, finished, resume, repeat)
        sweep(place)
        check_space(listed, place, finished)
        walk = _Walk(listed, place, finished, log, overwrite, stop, onlooker or Onlooker())
        return walk.through(sleep)


class _Walk:
    """One execution of a list, from its first step to its last."""

    def __init__(
        self,
        listed: ExperimentList,
        place: Path,
        finished: dict[str, Record],
        log: journal.Journal,
        overwrite: bool,
        stop: Callable[[], bool],
        onlooker: Onlooker,
    ) -> None:
        self._listed, self._place, self._finished = listed, place, finished
        self._log, self._overwrite, self._stop, self._onlooker = log, overwrite, stop, onlooker
        self._real = clock.real_time(listed.bench)
        self._records: dict[str, Record] = {}
        self._temperatures: dict[str, float] = {}
        self._known, self._shares = journal.shares(place), dict[tuple[Any, ...], float]()
        self._todo = [m for m in listed.measurements if m.name not in finished]

    def through(self, sleep: Callable[[float], None] | None) -> dict[str, Record]:
        """Execute every step that is left and return the records, those that were there before among them."""
        listed = self._listed
        self._course = Course(self._ahead_s(), self._real)
        if self._todo:
            self._announce()
        self._onlooker.begins(self._todo, list(self._finished), self._course)
        with task(listed.title or listed.name, len(listed.measurements)) as progress:
            for step in listed.steps:
                if isinstance(step, Measurement):
                    self._record(step, progress)
                # Nothing needs to come to rest, and no temperature to be known, when nothing more will be measured.
                elif self._todo and isinstance(step, Pause):
                    self._wait(step, sleep)
                elif self._todo and isinstance(step, Thermometer):
                    self._read(step)
        return self._records

    def _announce(self) -> None:
        """Write down what is going to be done, so that what never began can be told from what nobody asked for."""
        listed = self._listed
        provenance = getattr(listed.bench, "provenance", None)
        bench = {
            "made_by": getattr(provenance, "made_by", type(listed.bench).__name__),
            **getattr(provenance, "settings", {}),
        }
        planned = [{**m.describe(), "hash": m.hash, "comment": m.comment} for m in self._todo]
        rate_hz = getattr(listed.bench, "rate_hz", 0.0)
        heading = {"list": listed.title or listed.name, "list_hash": listed.hash, "bench": bench, "rate_hz": rate_hz}
        self._log.write("planned", at=clock.now(), measurements=planned, **heading)

    def _ahead_s(self) -> float:
        rate_hz = self._listed.bench.rate_hz if self._listed.bench is not None else 1.0
        pauses = sum(step.seconds for step in self._listed.steps if isinstance(step, Pause))
        return sum(m.samples for m in self._todo) / rate_hz + (pauses if self._real else 0.0)

    def _record(self, step: Measurement, progress: Task) -> None:
        record = self._finished.get(step.name)
        if record is None:
            if self._stop():
                self._end(f"stopped as asked before '{step.name}'", True)
            record = self._measured(self._levelled(step))
            self._todo.remove(step)
        self._records[step.name] = record
        progress.advance(note=step.name)

    def _levelled(self, step: Measurement) -> Measurement:
        """Return a measurement at the level that its sensors bear, which is found once for all rounds of a command."""
        bench = self._listed.bench
        assert bench is not None
        if not found_levels.asks(bench, step):
            return step
        command = (step.group, *(drive.actuator for drive in step.drives))
        share = self._shares.get(command, self._known.get(step.hash))
        if share is None:
            found = found_levels.levelled(bench, step, len(self._records), self._stop)
            if found is None:
                self._end(f"stopped as asked before '{step.name}'", True)
            share = found.share
            if share < 1.0:
                self._onlooker.lowers(found.sentence(step, bench.actuators))
        self._shares[command] = share
        self._log.write("levelled", at=clock.now(), name=step.name, hash=step.hash, share=share)
        return step if share == 1.0 else found_levels.lowered(step, share)

    def _measured(self, step: Measurement) -> Record:
        bench, begun = self._listed.bench, clock.now()
        assert bench is not None
        levels = Levels(bench.actuators, bench.sensors)
        self._onlooker.measures(step, levels)
        self._log.write("begun", at=begun, name=step.name, hash=step.hash)

        def on_block(block: Any) -> None:
            levels.take(block)
            self._course.advance(block.readings.shape[1] / bench.rate_hz)
            self._onlooker.advances(step, levels)

        watch = Watch(self._stop, on_block, self._conditions(step, begun))
        measured = measure(self._listed, step, len(self._records), self._place, self._overwrite, watch)
        self._report(step, measured, levels)
        if measured.aborted:
            of = f"'{step.name}' after {measured.record.samples} of {step.samples} samples"
            on_request = self._stop()
            self._end(f"stopped as asked in {of}" if on_request else f"the bench ended {of}", on_request)
        return measured.record

    def _conditions(self, step: Measurement, begun: str) -> dict[str, Any]:
        known: dict[str, Any] = {"begun": begun}
        if self._temperatures:
            latest = list(self._temperatures.values())[-1]
            known |= {"temperature_c": latest, "temperatures_c": dict(self._temperatures)}
        return known | ({"comment": step.comment} if step.comment else {})

    def _report(self, step: Measurement, measured: Measured, levels: Levels) -> None:
        warnings = list(levels.warnings(excited=bool(step.drives)))
        notes = {"warnings": warnings, "overruns": measured.overruns}
        event = "aborted" if measured.aborted else "finished"
        self._log.write(event, at=clock.now(), name=step.name, hash=step.hash, record=measured.record.hash, **notes)
        self._onlooker.ends(step, levels, ABORTED if measured.aborted else DONE, warnings)

    def _end(self, sentence: str, on_request: bool) -> NoReturn:
        raise StoppedError(sentence, states(self._listed.measurements, self._place), on_request)

    def _wait(self, step: Pause, sleep: Callable[[float], None] | None) -> None:
        self._onlooker.waits(step.seconds, skipped=sleep is None and not self._real)
        if sleep is not None:
            sleep(step.seconds)
        elif self._real:
            clock.rest(step.seconds, self._stop)
        if self._real:
            self._course.advance(step.seconds)

    def _read(self, step: Thermometer) -> None:
        value = clock.temperature_c(self._listed.bench)
        # The latest reading stands last, whatever its name.
        self._temperatures.pop(step.name, None)
        self._temperatures[step.name] = value
        self._log.write("temperature", at=clock.now(), name=step.name, temperature_c=value)
        self._onlooker.reads(step.name, value)
