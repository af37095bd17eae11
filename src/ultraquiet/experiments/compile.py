"""From the commands of an experiment list to a plan: the whole list is checked before anything moves."""

import inspect
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.lines import Place
from ultraquiet._base.mistakes import Mistakes
from ultraquiet._base.tables import Method
from ultraquiet.experiments import command as c
from ultraquiet.experiments.channels import rows
from ultraquiet.experiments.checks import Checks, Disturbance
from ultraquiet.experiments.making import make
from ultraquiet.experiments.mistakes import UNDEFINED, add_command_refusal
from ultraquiet.experiments.plan import Drive, Measurement, Pause, Step, Thermometer, duration_s
from ultraquiet.files import load as load_value
from ultraquiet.signals import Signal
from ultraquiet.values import Channel, StateSpace
from ultraquiet.values.channel import usual_level

DEFAULT_SAMPLES = 4096  # at every rate: lines a 4096th of it apart, enough for models of some tens of states
# Rounds within rounds multiply; a slip of the pen must not keep the check busy for days.
MOST_COMMANDS = 100_000
# Branches of the tree of seeds, so that a disturbance never draws what an excitation draws.
_EXCITATION, _DISTURBANCE = 0, 1
# Stands for an actuator that does not exist, so that its signal is checked all the same.
_NOWHERE = -1
_COMMAND: TypeAdapter[Any] = TypeAdapter(c.Command)
_VARIABLE = re.compile(r"\$([A-Za-z_][A-Za-z0-9_]*)")


class Compiler:
    """Walks the commands in order, as the bench would, and collects steps and mistakes."""

    def __init__(self, bench: Any | None, folder: Path | None, seed: int, mistakes: Mistakes) -> None:
        self.steps: list[Step] = []
        self._bench = bench
        self._folder = folder
        self._mistakes = mistakes
        self._checks = Checks(bench, mistakes)
        self._seed = seed
        self._samples = DEFAULT_SAMPLES
        self._limit = float("inf")
        self._levels: dict[str, dict[str, list[str]]] = {}
        self._longest: tuple[float, Place] | None = None
        self._variables: dict[str, Any] = {}
        self._controller: tuple[StateSpace | None, str] = (None, "")
        self._disturbance: Disturbance | None = None
        self._met = True
        self._names: dict[str, int] = {}
        self._count = 0
        self._walked = 0
        self._round = ""

    def walk(self, commands: Sequence[Any], place: Place) -> None:
        """Check and plan a sequence of commands that stands at `place`."""
        for k, raw in enumerate(commands):
            at = (*place, k)
            self._walked += 1
            if self._walked > MOST_COMMANDS:
                self._mistakes.add(at, f"the list comes to more than {MOST_COMMANDS} commands here; repeat less often.")
                return
            filled = self._fill(raw, at)
            try:
                checked = _COMMAND.validate_python(filled)
            except ValidationError as error:
                add_command_refusal(self._mistakes, at, error, c.VOCABULARY.get(_word(filled)))
                self._look_inside(raw, filled, at)
                continue
            getattr(self, "_" + checked.do.replace("-", "_"))(checked, at)

    def finish(self) -> None:
        """Check what shows only at the end of the list."""
        self._meet_nothing()
        if self._longest is None or self._bench is None:
            return
        longest_s, place = self._longest
        total_s = duration_s(self.steps, self._bench.rate_hz)
        if total_s > longest_s:
            self._mistakes.add(place, f"the list takes {total_s:.1f} s on the bench, more than {longest_s:g} s.")

    @property
    def said(self) -> tuple[str, ...]:
        """What was settled that the list leaves open, a sentence each."""
        told: list[str] = []
        for who, levels in self._levels.items():
            shares = "; ".join(f"{level} on {', '.join(names)}" for level, names in levels.items())
            told.append(f"{who} names no level: {shares}.")
        return tuple(told)

    def _look_inside(self, raw: Any, filled: Any, place: Place) -> None:
        """Check the parts of a refused command that can be checked on their own."""
        word = _word(filled)
        if word == "repeat" and isinstance(raw.get("commands"), list):
            self._walk_round(UNDEFINED, raw["commands"], place)
        # What switches these off again must not be told that nothing is on.
        if word == "controller-on":
            self._controller = (None, "refused")
        if word == "disturbance-on":
            self._meet_nothing()
            self._disturbance = Disturbance((), place)
        signal = filled.get("signal") if isinstance(filled, Mapping) else None
        if isinstance(signal, Mapping) and isinstance(signal.get("method"), str):
            method = Method.model_validate(signal)
            excitation = make("signals", method, (*place, "signal"), self._mistakes)
            drive = Drive(method.method, excitation, _NOWHERE, 0)
            self._checks.signals([drive], (*place, "signal"), self._samples, self._limit)

    def _fill(self, raw: Any, place: Place) -> Any:
        """Return a command with "$name" replaced; the body of a repeat is filled in its own turn."""
        if isinstance(raw, str) and (match := _VARIABLE.fullmatch(raw)):
            if match[1] in self._variables:
                return self._variables[match[1]]
            self._mistakes.add(place, f"there is no variable '{match[1]}' here; give it a value with 'set' before.")
            return UNDEFINED
        if isinstance(raw, Mapping):
            return {k: v if k == "commands" else self._fill(v, (*place, k)) for k, v in raw.items()}
        if isinstance(raw, list):
            return [self._fill(v, (*place, k)) for k, v in enumerate(raw)]
        return raw

    def _set(self, command: c.Set, place: Place) -> None:
        for key, value in (command.model_extra or {}).items():
            if value is not UNDEFINED and (
                not _VARIABLE.fullmatch(f"${key}") or not isinstance(value, int | float | str)
            ):
                self._mistakes.add((*place, key), f"'{key}' cannot be set to {value!r}; it takes a number or a text.")
            self._variables[key] = value

    def _configure(self, command: c.Configure, place: Place) -> None:
        self._samples = command.samples or self._samples
        self._seed = self._seed if command.seed is None else command.seed
        self._limit = command.limit or self._limit
        if command.max_duration_s is not None:
            self._longest = (command.max_duration_s, (*place, "max_duration_s"))

    def _wait(self, command: c.Wait, place: Place) -> None:
        self.steps.append(Pause(command.seconds, self._mistakes.line(place)))

    def _temperature(self, command: c.Temperature, place: Place) -> None:
        # Looked up without being read: nothing is asked of a bench before the list is known to be sound.
        if self._bench is not None and inspect.getattr_static(self._bench, "temperature_c", None) is None:
            self._mistakes.add(place, f"{type(self._bench).__name__} has no thermometer; leave 'temperature' out.")
        self.steps.append(Thermometer(command.name, self._mistakes.line(place)))

    def _repeat(self, command: c.Repeat, place: Place) -> None:
        outer = self._round
        for k in range(1, command.times + 1):
            if self._walked > MOST_COMMANDS:
                break
            self._round = f"{outer}-r{k}"
            self._walk_round(k, command.commands, place)
        self._round = outer

    def _walk_round(self, number: Any, commands: Sequence[Any], place: Place) -> None:
        """Walk the body of a repeat; `$round` is the round's number inside and afterwards what it was before."""
        outer = {"round": self._variables["round"]} if "round" in self._variables else {}
        self._variables["round"] = number
        self.walk(commands, (*place, "commands"))
        del self._variables["round"]
        self._variables |= outer

    def _excite(self, command: c.Excite, place: Place) -> None:
        signal = make("signals", command.signal, (*place, "signal"), self._mistakes)
        selected = self._rows(command.actuator, (*place, "actuator"))
        samples = command.samples or self._samples
        seeds = self._seeds(command.seed, self._count)
        method, who = command.signal.method, f"'{command.name}'"
        drives = [self._drive(method, signal, row, who, seeds(row)) for row in selected]
        tried = drives or [Drive(method, signal, _NOWHERE, 0)]
        self._check(tried, (*place, "signal"), samples)
        if command.actuator == "each":
            for drive in drives or [None]:
                number = "" if drive is None else f"-{drive.actuator + 1}"
                self._measure(command, number, samples, (drive,) if drive else (), place)
        else:
            self._measure(command, "", samples, tuple(drives), place)

    def _record(self, command: c.RecordOnly, place: Place) -> None:
        samples = command.samples or self._samples
        self._check([], (*place, "signal"), samples)
        self._measure(command, "", samples, (), place)

    def _check(self, drives: Sequence[Drive], place: Place, samples: int) -> None:
        self._checks.signals(drives, place, samples, self._limit, self._disturbance)
        self._met = True

    def _measure(
        self, command: c.Excite | c.RecordOnly, number: str, samples: int, drives: tuple[Drive, ...], place: Place
    ) -> None:
        group = command.name
        name, line = group + number + self._round, self._mistakes.line(place)
        # File systems may take 'A' and 'a' for one name.
        first = self._names.get(name.lower())
        if first is not None:
            self._mistakes.add(
                (*place, "name"), f"'{group}' names records that line {first} leaves already; rename one."
            )
        self._names[name.lower()] = line
        self._count += 1
        on = self._disturbance.drives if self._disturbance else ()
        law, file = self._controller
        self.steps.append(Measurement(name, group, line, samples, drives, on, law, file, command.comment))

    def _controller_on(self, command: c.ControllerOn, place: Place) -> None:
        path = Path(command.file) if self._folder is None else self._folder / command.file
        self._controller = (None, command.file)
        try:
            law = load_value(path)
        except (UltraquietError, ValueError) as error:
            self._mistakes.add((*place, "file"), str(error))
            return
        fault = self._checks.misfit(law)
        if fault:
            self._mistakes.add((*place, "file"), f"'{command.file}' {fault}.")
        self._controller = (law if isinstance(law, StateSpace) else None, command.file)

    def _controller_off(self, command: c.ControllerOff, place: Place) -> None:
        if not self._controller[1]:
            self._mistakes.add(place, "no controller is on here; a 'controller-on' must come before.")
        self._controller = (None, "")

    def _disturbance_on(self, command: c.DisturbanceOn, place: Place) -> None:
        self._meet_nothing()
        key = "source" if command.source is not None else "actuator"
        meant = command.source if command.actuator is None else command.actuator
        if command.source is not None and command.actuator is not None:
            self._mistakes.add((*place, "source"), "'source' and 'actuator' mean the same here; leave one out.")
        if meant == "each":
            self._mistakes.add((*place, key), "'each' is for 'excite'; a disturbance takes actuators or \"all\".")
        signal = make("signals", command.signal, (*place, "signal"), self._mistakes)
        selected = self._rows("all" if meant is None else meant, (*place, key))
        seeds = self._seeds(command.seed, self._count, _DISTURBANCE)
        method, who = command.signal.method, f"the disturbance of line {self._mistakes.line(place)}"
        drives = [self._drive(method, signal, row, who, seeds(row)) for row in selected]
        self._disturbance = Disturbance(tuple(drives), (*place, "signal"))
        self._met = False

    def _disturbance_off(self, command: c.DisturbanceOff, place: Place) -> None:
        if self._disturbance is None:
            self._mistakes.add(place, "no disturbance is on here; a 'disturbance-on' must come before.")
        self._meet_nothing()
        self._disturbance = None

    def _meet_nothing(self) -> None:
        """Check a disturbance that no measurement has met, which is when its own length would be known."""
        if not self._met:
            self._check([], (), self._samples)

    def _rows(self, actuator: Any, place: Place) -> list[int]:
        """Return the actuators counted from 0; none when the bench is not known yet."""
        if self._bench is None:
            return []
        selected, faults = rows(self._bench.actuators, actuator)
        for fault in faults:
            self._mistakes.add(place, fault)
        return selected

    def _drive(self, method: str, signal: Any, row: int, who: str, seed: int) -> Drive:
        unnamed = signal.unnamed_levels() if isinstance(signal, Signal) else ()
        return Drive(method, self._levelled(signal, row, who), row, seed, unnamed)

    def _levelled(self, signal: Any, row: int, who: str) -> Any:
        """Return the signal with what its actuator takes wherever it names no level; that is said of `who` once."""
        if self._bench is None or not isinstance(signal, Signal) or not signal.unnamed_levels():
            return signal
        channel: Channel = self._bench.actuators[row]
        within = replace(channel, low=max(channel.low, -self._limit), high=min(channel.high, self._limit))
        level = usual_level([within])
        why = "without limits" if within.high == -within.low == float("inf") else "a tenth of the swing"
        names = self._levels.setdefault(who, {}).setdefault(f"{channel.in_unit(level)} ({why})", [])
        if channel.name not in names:
            names.append(channel.name)
        return signal.at(level)

    def _seeds(self, own: int | None, index: int, branch: int = _EXCITATION) -> Any:
        """Return row -> seed: independent for every actuator, and for every command without a seed of its own."""
        key = (branch,) if own is not None else (branch, index)
        return lambda row: int(
            np.random.SeedSequence(self._seed if own is None else own, spawn_key=(*key, row)).generate_state(1)[0]
        )


def _word(raw: Any) -> str:
    return str(raw.get("do", "")) if isinstance(raw, Mapping) else ""
