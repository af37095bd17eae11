"""A study by hand: a log of steps in a folder, boards that are their sum, undo, and what is stale."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from threading import RLock
from typing import Any

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.files import reason, write_bytes
from ultraquiet.workbench.engine import adopt
from ultraquiet.workbench.engine.items import FACTS, FOLDER, LATEST, Item, changes, item_of, order
from ultraquiet.workbench.engine.making import work
from ultraquiet.workbench.engine.steps import BOARDS, State, Step, applied, empty
from ultraquiet.workbench.engine.written import study_text
from ultraquiet.workbench.engine.written.own_files import OwnFiles
from ultraquiet.workbench.engine.written.script import script

LOG, WRITTEN = "log.json", "written.json"
STUDY, SCRIPT = "study.toml", "study.py"


class Session:
    """A study folder and what a hand has done in it; any number of views may look at one session.

    Every step is kept in `workbench/log.json` as soon as it is made; the values it leads to are made by `make`, here
    or in another process, and found again by what they depend on, so that an undone step costs nothing to redo.

    Args:
        folder: of the study; made when absent. One that `ultraquiet run` left is taken over as it is.

    Raises:
        StorageError: the folder cannot be written, or its log cannot be read.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(os.path.realpath(folder))  # a link to itself is refused below
        self._lock = RLock()
        self._watchers: list[Callable[[], object]] = []
        try:
            (self.folder / FOLDER / "items").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"workbench: '{folder}' cannot be written ({reason(error)}).") from error
        self._steps, self._cursor = self._read()
        self.version = 0
        self._state = self._replayed()
        self._taking_over = False
        self._own = OwnFiles(self.folder, self.folder / FOLDER / WRITTEN)
        if self._steps:
            self._own.recognise(self._texts())
        self._take_over()

    @property
    def state(self) -> State:
        """The boards as they stand: board -> name -> recipe."""
        return self._state

    @property
    def steps(self) -> Sequence[Step]:
        """The steps that are in force, in their order."""
        return self._steps[: self._cursor]

    @property
    def can_undo(self) -> bool:
        """Whether there is a step to take back."""
        return self._cursor > 0

    @property
    def can_redo(self) -> bool:
        """Whether a step was taken back."""
        return self._cursor < len(self._steps)

    def do(self, step: Step) -> None:
        """Take a step; what had been undone is forgotten.

        Raises:
            InputError: the step will not do; nothing has changed.
            StorageError: it could not be kept; nothing has changed.
        """
        with self._lock:
            after = applied(self._state, step)
            study_text.toml(after)  # what no study file can say is refused before it is in the log
            self._change([*self._steps[: self._cursor], dict(step)], self._cursor + 1, after)

    def undo(self) -> None:
        """Take the last step back; the values it led to stay for a redo."""
        with self._lock:
            if self.can_undo:
                self._change(self._steps, self._cursor - 1)

    def redo(self) -> None:
        """Take the next step again that was taken back."""
        with self._lock:
            if self.can_redo:
                self._change(self._steps, self._cursor + 1)

    def item(self, board: str, name: str) -> Item:
        """Return an item of a board.

        Raises:
            InputError: the board holds no such item.
        """
        if board not in BOARDS or name not in self._state[board]:
            raise InputError(f"workbench: the board {board} holds no '{name}'.")
        return item_of(self.folder, self._state, board, name)

    def items(self, board: str) -> list[Item]:
        """Return the items of a board in the order they were made."""
        state = self._state
        return [item_of(self.folder, state, board, name) for name in state[board]]

    def make(self, board: str, name: str) -> Item:
        """Make an item here and now, with all it is made of; errors as in `work.make`."""
        item = work.make(self.folder, self._state, board, name, shared=True)
        self.made(board, name)
        return item

    def made(self, board: str, name: str) -> None:
        """Note that an item was made, so that it can be told later what of it is stale."""
        with self._lock:
            latest = self._latest()
            for each, one in order(self._state, board, name):
                item = item_of(self.folder, self._state, each, one)
                if item.ready:
                    latest[f"{each}/{one}"] = item.key
            write_bytes(self.folder / FOLDER / LATEST, json.dumps(latest, indent=1).encode())
            self._publish()
            self._told()

    def measured_anew(self) -> None:
        """Take the records that were measured once more since they came onto the boards; what was taken back stays."""
        with self._lock:
            for step in adopt.measured_anew(self.folder, self.items("data")):
                steps = [*self._steps[: self._cursor], step, *self._steps[self._cursor :]]
                self._change(steps, self._cursor + 1, applied(self._state, step))

    def stale(self, board: str, name: str) -> tuple[Item, str] | None:
        """Return what was made of an item before its inputs changed, and what changed; None where it is up to date."""
        item = self.item(board, name)
        key = self._latest().get(f"{board}/{name}")
        if item.ready or key is None:
            return None
        old = Item(board, name, item.recipe, key, item.folder.with_name(f"{board}-{key}"))
        if not (old.folder / FACTS).exists():
            return None
        was: Mapping[str, Any] = old.facts.get("recipes", {})
        now = {f"{b}/{n}": self._state[b][n] for b, n in order(self._state, board, name)}
        words = [f"{key}: {', '.join(changes(was.get(key, {}), now[key]))}" for key in now if was.get(key) != now[key]]
        return old, "; ".join(words) or "what it was made of is gone"

    def python(self) -> str:
        """Return everything that was done as a Python script that gives the same numbers."""
        return script(self._state, self.folder)

    def toml(self) -> str:
        """Return everything that was done as a study file that gives the same numbers."""
        return study_text.toml(self._state)

    def watch(self, watcher: Callable[[], object]) -> Callable[[], None]:
        """Call `watcher` after every change; return what ends that."""
        self._watchers.append(watcher)
        return lambda: self._watchers.remove(watcher) if watcher in self._watchers else None

    def _change(self, steps: list[Step], cursor: int, state: State | None = None) -> None:
        text = json.dumps({"version": 1, "cursor": cursor, "steps": steps}, indent=1)
        write_bytes(self.folder / FOLDER / LOG, text.encode())
        self._steps, self._cursor = list(steps), cursor
        self._state = self._replayed() if state is None else state
        self._publish()
        self._told()

    def _told(self) -> None:
        self.version += 1
        for watcher in list(self._watchers):
            watcher()

    def _publish(self) -> None:
        """Leave study and script in the folder; a study that lacks a model or a law is no study yet.

        What a hand has written there is kept under another name; a study that is only taken over stays as it is.
        """
        if self._taking_over:
            return
        self._own.write(self._texts())
        study_text.publish(self.folder, self._state)

    def _texts(self) -> dict[str, str]:
        return {SCRIPT: self.python(), STUDY: self.toml()}

    def _replayed(self) -> State:
        state = empty(self.folder.name)
        for step in self._steps[: self._cursor]:
            state = applied(state, step)
        return state

    def _read(self) -> tuple[list[Step], int]:
        path = self.folder / FOLDER / LOG
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            return list(content["steps"]), int(content["cursor"])
        except FileNotFoundError:
            return [], 0
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise StorageError(
                f"workbench: '{path}' cannot be read ({reason(error)}); move it away to begin anew on these records."
            ) from error

    def _take_over(self) -> None:
        """Begin with what `ultraquiet run` has left in the folder, a study or records that it measured anew."""
        before, self._taking_over = len(self._steps), True
        if not self._steps:
            for step in adopt.steps_of(self.folder):
                self.do(step)
        self.measured_anew()
        self._taking_over = False
        if len(self._steps) > before and not any(self._own.is_foreign(*each) for each in self._texts().items()):
            self._publish()

    def _latest(self) -> dict[str, str]:
        try:
            return dict(json.loads((self.folder / FOLDER / LATEST).read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            return {}
