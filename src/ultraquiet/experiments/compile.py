"""From the text of an experiment list to a plan: the whole list is checked before anything moves."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.lines import Place
from ultraquiet._base.registry import lookup
from ultraquiet.experiments import command as c
from ultraquiet.experiments.mistakes import Mistakes
from ultraquiet.experiments.plan import Drive, Measurement, Pause, Step
from ultraquiet.files import load as load_value
from ultraquiet.values import Channel, StateSpace

DEFAULT_SAMPLES = 4096  # the paper's record length, section 3.4
# Branches of the tree of seeds, so that a disturbance never draws what an excitation draws.
_EXCITATION, _DISTURBANCE = 0, 1
_COMMAND: TypeAdapter[Any] = TypeAdapter(c.Command)
_VARIABLE = re.compile(r"\$([A-Za-z_][A-Za-z0-9_]*)")


def make(family: str, method: c.Method, place: Place, mistakes: Mistakes) -> Any | None:
    """Return the registered settings object, or None; every mistake in it is noted.

    Settings that do not exist are noted and left out, so that what comes after is checked all the same.
    """
    try:
        kind = lookup(family, method.method)
    except UltraquietError as error:
        mistakes.add((*place, "method"), str(error))
        return None
    known = {f.name: f for f in fields(kind) if f.init}
    for key in method.settings:
        if key not in known:
            said = ", ".join(known)
            mistakes.add((*place, key), f"{family} '{method.method}' has no setting '{key}'; known are {said}.")
    for key, field in known.items():
        needed = field.default is MISSING and field.default_factory is MISSING
        if needed and key not in method.settings:
            mistakes.add(place, f"{family} '{method.method}' lacks its setting '{key}'.")
            return None
    try:
        return kind(**{key: value for key, value in method.settings.items() if key in known})
    except (UltraquietError, TypeError, ValueError) as error:
        mistakes.add(place, str(error))
        return None


class Compiler:
    """Walks the commands in order, as the bench would, and collects steps and mistakes."""

    def __init__(self, bench: Any | None, folder: Path | None, seed: int, mistakes: Mistakes) -> None:
        self.steps: list[Step] = []
        self._bench = bench
        self._folder = folder
        self._mistakes = mistakes
        self._seed = seed
        self._samples = DEFAULT_SAMPLES
        self._limit_v = float("inf")
        self._variables: dict[str, Any] = {}
        self._controller: tuple[StateSpace | None, str] = (None, "")
        self._disturbances: tuple[Drive, ...] | None = None
        self._names: dict[str, int] = {}
        self._count = 0
        self._round = ""

    def walk(self, commands: Sequence[Any], place: Place) -> None:
        """Check and plan a sequence of commands that stands at `place`."""
        for k, raw in enumerate(commands):
            at = (*place, k)
            filled = self._fill(raw, at)
            try:
                checked = _COMMAND.validate_python(filled)
            except ValidationError as error:
                self._mistakes.add_refusal(at, error, c.VOCABULARY.get(_word(filled)))
                self._look_inside(raw, filled, at)
                continue
            getattr(self, "_" + checked.do.replace("-", "_"))(checked, at)

    def _look_inside(self, raw: Any, filled: Any, place: Place) -> None:
        """Check the parts of a refused command that can be checked on their own."""
        if _word(filled) == "repeat" and isinstance(raw.get("commands"), list):
            self.walk(raw["commands"], (*place, "commands"))
        signal = filled.get("signal") if isinstance(filled, Mapping) else None
        if isinstance(signal, Mapping) and isinstance(signal.get("method"), str):
            method = c.Method.model_validate(signal)
            made = make("signals", method, (*place, "signal"), self._mistakes)
            self._check_volts([Drive(method.method, made, 0, 0)], self._samples, (*place, "signal"))

    def _fill(self, raw: Any, place: Place) -> Any:
        """Return a command with "$name" replaced; the body of a repeat is filled in its own turn."""
        if isinstance(raw, str) and (found := _VARIABLE.fullmatch(raw)):
            if found[1] in self._variables:
                return self._variables[found[1]]
            self._mistakes.add(place, f"there is no variable '{found[1]}' here; give it a value with 'set' before.")
        elif isinstance(raw, Mapping):
            return {k: v if k == "commands" else self._fill(v, (*place, k)) for k, v in raw.items()}
        elif isinstance(raw, list):
            return [self._fill(v, (*place, k)) for k, v in enumerate(raw)]
        return raw

    def _set(self, command: c.Set, place: Place) -> None:
        for key, value in (command.model_extra or {}).items():
            if not _VARIABLE.fullmatch(f"${key}") or not isinstance(value, int | float | str):
                self._mistakes.add((*place, key), f"'{key}' cannot be set to {value!r}; it takes a number or a text.")
            self._variables[key] = value

    def _configure(self, command: c.Configure, place: Place) -> None:
        self._samples = command.samples or self._samples
        self._seed = self._seed if command.seed is None else command.seed
        self._limit_v = command.limit_v or self._limit_v

    def _wait(self, command: c.Wait, place: Place) -> None:
        self.steps.append(Pause(command.seconds, self._mistakes.line(place)))

    def _repeat(self, command: c.Repeat, place: Place) -> None:
        outer = self._round
        for k in range(1, command.times + 1):
            self._round, self._variables["round"] = f"{outer}-r{k}", k
            self.walk(command.commands, (*place, "commands"))
        self._round = outer

    def _excite(self, command: c.Excite, place: Place) -> None:
        signal = make("signals", command.signal, (*place, "signal"), self._mistakes)
        rows = self._rows(command.actuator, (*place, "actuator"))
        samples = command.samples or self._samples
        seeds = self._seeds(command.seed, self._count)
        drives = [Drive(command.signal.method, signal, row, seeds(row)) for row in rows]
        self._check_volts(drives, samples, (*place, "signal"))
        if command.actuator == "each":
            for drive in drives or [None]:
                number = "" if drive is None else f"-{drive.actuator + 1}"
                self._measure(command.name, number, samples, (drive,) if drive else (), place)
        else:
            self._measure(command.name, "", samples, tuple(drives), place)

    def _record(self, command: c.RecordOnly, place: Place) -> None:
        self._measure(command.name, "", command.samples or self._samples, (), place)

    def _measure(self, group: str, number: str, samples: int, drives: tuple[Drive, ...], place: Place) -> None:
        name, line = group + number + self._round, self._mistakes.line(place)
        # File systems may take 'A' and 'a' for one name.
        first = self._names.get(name.lower())
        if first is not None:
            self._mistakes.add(
                (*place, "name"), f"'{group}' names records that line {first} leaves already; rename one."
            )
        self._names[name.lower()] = line
        self._count += 1
        law, file = self._controller
        self.steps.append(Measurement(name, group, line, samples, drives, self._disturbances or (), law, file))

    def _controller_on(self, command: c.ControllerOn, place: Place) -> None:
        path = Path(command.file) if self._folder is None else self._folder / command.file
        try:
            law = load_value(path)
        except UltraquietError as error:
            self._mistakes.add((*place, "file"), str(error))
            self._controller = (None, command.file)
            return
        fault = self._misfit(law)
        if fault:
            self._mistakes.add((*place, "file"), f"'{command.file}' {fault}.")
        self._controller = (law if isinstance(law, StateSpace) else None, command.file)

    def _misfit(self, law: Any) -> str:
        if not isinstance(law, StateSpace) or law.rate_hz is None:
            return f"holds a {type(law).__name__}; a controller is a StateSpace in discrete time"
        if self._bench is None:
            return ""
        if abs(law.rate_hz - self._bench.rate_hz) > 1e-9 * law.rate_hz:
            return f"runs at {law.rate_hz:g} Hz, the bench at {self._bench.rate_hz:g} Hz"
        shape = (len(self._bench.actuators), len(self._bench.sensors))
        return "" if law.D.shape == shape else f"has (commands, readings) {law.D.shape}, the bench {shape}"

    def _controller_off(self, command: c.ControllerOff, place: Place) -> None:
        if not self._controller[1]:
            self._mistakes.add(place, "no controller is on here; a 'controller-on' must come before.")
        self._controller = (None, "")

    def _disturbance_on(self, command: c.DisturbanceOn, place: Place) -> None:
        if command.actuator == "each":
            self._mistakes.add((*place, "actuator"), "'each' is for 'excite'; a disturbance takes numbers or \"all\".")
            return
        signal = make("signals", command.signal, (*place, "signal"), self._mistakes)
        rows = self._rows(command.actuator, (*place, "actuator"))
        seeds = self._seeds(command.seed, self._count, _DISTURBANCE)
        self._disturbances = tuple(Drive(command.signal.method, signal, row, seeds(row)) for row in rows)
        self._check_volts(self._disturbances, self._samples, (*place, "signal"))

    def _disturbance_off(self, command: c.DisturbanceOff, place: Place) -> None:
        if self._disturbances is None:
            self._mistakes.add(place, "no disturbance is on here; a 'disturbance-on' must come before.")
        self._disturbances = None

    def _rows(self, actuator: Any, place: Place) -> list[int]:
        """Return the actuators counted from 0; none when the bench is not known yet."""
        if self._bench is None:
            return []
        count = len(self._bench.actuators)
        if actuator in ("each", "all"):
            return list(range(count))
        numbers = actuator if isinstance(actuator, list) else [actuator]
        for number in numbers:
            if number > count:
                self._mistakes.add(place, f"there is no actuator {number}; the bench has 1 to {count}.")
        return [n - 1 for n in numbers if n <= count]

    def _seeds(self, own: int | None, index: int, branch: int = _EXCITATION) -> Any:
        """Return row -> seed: independent for every actuator, and for every command without a seed of its own."""
        key = (branch,) if own is not None else (branch, index)
        return lambda row: int(
            np.random.SeedSequence(self._seed if own is None else own, spawn_key=(*key, row)).generate_state(1)[0]
        )

    def _check_volts(self, drives: Sequence[Drive], samples: int, place: Place) -> None:
        for drive in drives:
            if drive.signal is None or self._bench is None:
                return
            try:
                u = drive.signal.generate(samples=samples, rate_hz=self._bench.rate_hz, seed=drive.seed)
            except UltraquietError as error:
                self._mistakes.add(place, str(error))
                return
            fault = _beyond(u, self._bench.actuators[drive.actuator], self._limit_v)
            if fault:
                self._mistakes.add(place, fault)
                return


def _beyond(u: Any, channel: Channel, limit_v: float) -> str:
    low, high = max(channel.low, -limit_v), min(channel.high, limit_v)
    if low <= u.min() and u.max() <= high:
        return ""
    whose = "the list's own limit" if limit_v < min(-channel.low, channel.high) else f"the limits of '{channel.name}'"
    return f"the signal spans {u.min():g} to {u.max():g} {channel.unit}, beyond {whose}, {low:g} to {high:g}; lower it."


def _word(raw: Any) -> str:
    return str(raw.get("do", "")) if isinstance(raw, Mapping) else ""
