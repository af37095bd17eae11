"""Records: drop a file, say which column is what, cut, detrend and split, and see what the data are worth."""

import re
from collections.abc import Callable
from typing import Any

from nicegui import events, ui

from ultraquiet._base.errors import UltraquietError
from ultraquiet.files.formats import FORMATS
from ultraquiet.workbench.engine.making.imports import import_step, proposed_name, received
from ultraquiet.workbench.engine.roles import guessed_roles
from ultraquiet.workbench.figures.traces import traces
from ultraquiet.workbench.web.chart import ChartElement
from ultraquiet.workbench.web.controls import button, choice, field, heading, say, table, words
from ultraquiet.workbench.web.shell import Columns, doing, making
from ultraquiet.workbench.web.view import Looker, View

ROLES = ("input", "output", "leave out")
READ = ", ".join(form.name for form in FORMATS)
TRAIN_SHARE = 0.6
MOST_BYTES = 4 << 30
NO_RATE = "states no sampling rate"
RATE_ASKED = re.compile(r"give (?:it with )?--rate \(rate_hz=\)")
COLUMNS = {
    "column": "",
    "what it is": "input: a command that was sent; output: a reading",
    "name": "",
    "unit": "",
    "low limit": "the least command that the amplifier takes, or reading that the converter gives, in the unit",
    "high limit": "the largest command that the amplifier takes, or reading that the converter gives, in the unit",
    "rms": "of the file's numbers",
    "clipped": "samples in flat tops, at the highest or the lowest value",
}
LIMITS = "Limits are in the channel's unit; left empty they are unknown, and the code keeps to what the record holds."
NO_RECORD = "records: there is no record yet; drop a file first, or click one on the board."


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    with columns.main:
        shown = _Shown(view, _Drop(view))
    with columns.side:
        shown.settings()


class _Drop:
    """Where files are dropped, and the table in which their columns get roles, names and units."""

    def __init__(self, view: View) -> None:
        self.view, self.file, self.rows = view, "", []
        self.offered = False  # whether a file waits for its columns to be told apart
        self.told: Callable[[], object] = lambda: None  # is called when one does
        self._looker = Looker(view)
        self._upload = upload = ui.upload(
            on_upload=self._dropped, auto_upload=True, label=f"Drop a file here, or +  ({READ})"
        )
        upload.props(f'flat bordered data-testid="drop" max-file-size="{MOST_BYTES}"').classes("uq-drop")
        self._place = ui.element("div").props('data-testid="columns"')

    async def _dropped(self, event: events.UploadEventArguments) -> None:
        part = self.view.session.folder / "workbench" / ".dropped.part"
        try:
            await event.file.save(part)
            self.file = received(self.view.session.folder, event.file.name, part)
        except (OSError, UltraquietError) as error:
            say(f"records: '{event.file.name}' could not be kept ({error}).")
            return
        finally:
            part.unlink(missing_ok=True)
        self._upload.reset()
        self._ask(None)

    def _ask(self, rate_hz: float | None) -> None:
        self._place.clear()
        with self._place:
            words("Looking the file over …", "caption")
        self._looker.failed(self._refused)
        self._looker.ask("look over", f"look over {self.file}", self._offer, file=self.file, rate_hz=rate_hz)

    def _refused(self, sentence: str) -> None:
        self._place.clear()
        with self._place:
            words(sentence, "doubt").props('data-testid="refused"')
            words(f"What can be read: {READ}. Mend the file or export it again, and drop it once more.", "caption")

    def _offer(self, found: dict[str, Any], _: Any) -> None:
        self._place.clear()
        self.offered = True
        self.told()
        with self._place:
            length = "" if found["duration_s"] is None else f", {found['duration_s']:.4g} s"
            heading(f"{found['file'].rpartition('/')[2]}: {found['format']}, {found['size']}{length}")
            for note in notes_of(found):
                words(note, "doubt")
            self._columns(found["channels"], found["clock"])
            with ui.element("div").classes("uq-row"):
                rate_hz = found["rate_hz"] or found["clock_hz"]
                rate = "" if rate_hz is None else f"{rate_hz:.10g}"
                self.rate = field("rate (Hz)", "rate", rate, "samples per second", "170px")
                self.name = field("name of the record", "record-name", proposed_name(self.file), width="260px")
                button("Make the record", self._make, "make-record", main=True)

    def _columns(self, channels: list[dict[str, Any]], clock: str) -> None:
        self.rows = []
        roles, doubt = guessed_roles([channel for channel in channels if channel["name"] != clock])
        if doubt:
            words(doubt, "doubt").props('data-testid="unsure"')
        with ui.element("div").classes("uq-table-box"), ui.element("table").classes("uq-table uq-channels"):
            with ui.element("tr"):
                for title, meaning in COLUMNS.items():
                    with ui.element("th"):
                        made = ui.label(title)
                    if meaning:
                        made.tooltip(meaning)
            guessed = iter(roles)
            for k, channel in enumerate(channels):
                role = ROLES[-1] if channel["name"] == clock else next(guessed)
                with ui.element("tr"):
                    self.rows.append(self._column(k, channel, role))
        words(LIMITS, "caption")

    def _column(self, k: int, channel: dict[str, Any], role: str) -> dict[str, Any]:
        made: dict[str, Any] = {"column": channel["name"]}
        with ui.element("td"):
            ui.label(channel["name"])
        with ui.element("td").style("min-width: 120px"):
            made["role"] = choice("", ROLES, f"role-{k}", role, lambda _: None)
        for key, value, width in (
            ("name", channel["name"], 150),
            ("unit", channel["unit"], 64),
            ("low", "", 68),
            ("high", "", 68),
        ):
            with ui.element("td"):
                made[key] = field("", f"{key}-{k}", value, width=f"{width}px")
        for text in (f"{channel['rms']:.4g}", str(channel["clipped"])):
            with ui.element("td"):
                ui.label(text)
        return made

    def _make(self) -> None:
        try:
            rate = float(self.rate.value) if self.rate.value else None
            sides = {
                f"{role}s": [_channel(row) for row in self.rows if row["role"].value == role] for role in ROLES[:2]
            }
        except ValueError as error:
            say(f"records: {error}; write limits and the rate as numbers.")
            return
        if not sides["inputs"] or not sides["outputs"]:
            say("records: a record needs an input and an output; say which columns they are.")
            return
        name = str(self.name.value)
        try:
            step = import_step(self.view.session.folder, name, self.file, sides, rate)
        except UltraquietError as error:
            say(str(error))
            return
        if doing(self.view, step):
            making(self.view, "data", name)
            self.offered = False
            self.view.set(data=name)
            self._place.clear()


def notes_of(found: dict[str, Any]) -> list[str]:
    """Return what stands in the way of a file, as the page says it, which asks for a rate in a field.

    >>> notes_of({"notes": ["'a.csv' states no sampling rate; give it with --rate (rate_hz=)."], "clock": ""})
    ["'a.csv' states no sampling rate; write the rate below."]
    >>> notes_of({"notes": [], "clock": "Uhr", "clock_hz": 2000.0, "file": "imports/a.csv"})[0][:51]
    "'Uhr' rises evenly and is taken for a clock: 2000 H"
    """
    if found["clock"]:
        kept = [note for note in found["notes"] if NO_RATE not in note]
        taken = f"'{found['clock']}' rises evenly and is taken for a clock: {found['clock_hz']:.10g} Hz"
        return [*kept, f"{taken} if it counts seconds. Where it does not, mend the rate below."]
    return [RATE_ASKED.sub("write the rate below", note) for note in found["notes"]]


def _channel(row: dict[str, Any]) -> dict[str, Any]:
    made: dict[str, Any] = {"column": row["column"], "name": row["name"].value, "unit": row["unit"].value}
    low, high = row["low"].value, row["high"].value
    if low or high:
        made["limits"] = [float(low or -1e300), float(high or 1e300)]
    return made


class _Shown:
    """The record that is shown, and what can be done to it."""

    def __init__(self, view: View, drop: _Drop) -> None:
        self.view, self._drop = view, drop
        self._looker = Looker(view)
        self._drawn: Any = None
        self._facts: dict[str, Any] = {}
        self.chart = ChartElement(view.frames, "record-chart", on_zoom=self._zoomed)
        self._advice = ui.element("div")
        with ui.element("div").classes("uq-empty").props('data-testid="begin"') as self._begin:
            words("A study begins with a record: drop a file above, and say which of its columns are commands.")
            words("Then Identify makes a model of it, Design a law for the model, Deploy its C code.", "caption")
            ui.link("No file at hand? Measure on a bench, or open the demo's study", view.link("Bench")).props(
                'data-testid="to-bench"'
            )
        drop.told = self._refresh
        view.watch(self._refresh)

    def settings(self) -> None:
        """Build the settings beside."""
        heading("The record")
        self._words = ui.element("div").props('data-testid="record-facts"')
        heading("Cut")
        words("Drag over the chart, or write seconds; double click on the chart shows all again.", "caption")
        with ui.element("div").classes("uq-form"):
            self.start = field("from (s)", "cut-from", "0")
            self.stop = field("to (s)", "cut-to", "")
        self.cut_name = field("name", "cut-name", "", "as the record, -cut")
        with ui.element("div").classes("uq-row"):
            button("Cut", self._cut, "cut")
            button("Split in two", self._split, "split", tip="the first 60 % to identify from, the rest to judge by")
        heading("Detrend")
        with ui.element("div").classes("uq-row"):
            button("Take the mean away", lambda: self._detrend("mean"), "detrend-mean")
            button("Take a line away", lambda: self._detrend("line"), "detrend-line")
        heading("Go on")
        ui.link("Identify a model", self.view.link("Identify")).props('data-testid="to-identify"')
        self.view.watch(self._tell)

    @property
    def name(self) -> str | None:
        """The record that is shown."""
        names = self.view.shown("data")
        return names[-1] if names else None

    def _refresh(self) -> None:
        name = self.name
        self._begin.set_visibility(name is None and not self._drop.offered)
        if name is None:
            return
        item = self.view.session.item("data", name)
        if not item.ready or self._drawn == item.key:
            return
        self._drawn, self._facts = item.key, item.facts
        self._looker.ask("trace", f"show {name}", self._draw, name=name)

    def _draw(self, _: Any, arrays: dict[str, Any]) -> None:
        facts = self._facts
        channels = [(c[0], c[1]) for c in (*facts["actuators"], *facts["sensors"])]
        title = f"{self.name}: {facts['samples']} samples at {facts['rate_hz']:g} Hz"
        self.chart.show(traces(title, arrays["time_s"], arrays["signals"], channels, len(facts["actuators"])))
        self._advice.clear()
        with self._advice:
            for sentence in facts["advice"]:
                words(sentence, "doubt")

    def _tell(self) -> None:
        self._words.clear()
        name = self.name
        with self._words:
            if name is None:
                words("No record yet.", "caption")
                return
            facts = self.view.session.item("data", name).facts
            if facts:
                rows = [("length", f"{facts['duration_s']:.4g} s"), ("rate", f"{facts['rate_hz']:g} Hz")]
                rows += [("inputs", ", ".join(c[0] for c in facts["actuators"]))]
                rows += [("outputs", ", ".join(c[0] for c in facts["sensors"]))]
                rows += [("clipped samples", str(sum(facts["clipped"])))]
                table((name, ""), rows, "facts")

    def _zoomed(self, span: dict[str, Any]) -> None:
        low, high = span.get("lo"), span.get("hi")
        self.start.value = "0" if low is None else f"{max(0.0, low):.6g}"
        self.stop.value = "" if high is None else f"{high:.6g}"

    def _cut(self) -> None:
        if self.name is None:
            say(NO_RECORD)
            return
        try:
            rate = self._facts["rate_hz"]
            start = round(float(self.start.value or 0) * rate)
            stop = round(float(self.stop.value) * rate) if self.stop.value else self._facts["samples"]
        except (ValueError, KeyError):
            say("records: write the ends of the cut as seconds.")
            return
        stop = min(stop, self._facts["samples"])
        if not 0 <= start < stop:
            say(f"records: nothing lies between {self.start.value} and {self.stop.value} s; the start comes first.")
            return
        self._derive(self.cut_name.value or f"{self.name}-cut", {"op": "cut", "start": start, "stop": stop})

    def _split(self) -> None:
        name, samples = self.name, self._facts.get("samples", 0)
        if name is None or samples < 2:
            say(NO_RECORD)
            return
        at = int(TRAIN_SHARE * samples)
        self._derive(f"{name}-judge", {"op": "cut", "start": at, "stop": samples})
        self._derive(f"{name}-fit", {"op": "cut", "start": 0, "stop": at}, of=name)

    def _detrend(self, kind: str) -> None:
        if self.name is None:
            say(NO_RECORD)
            return
        self._derive(f"{self.name}-flat", {"op": "detrend", "kind": kind})

    def _derive(self, name: str, step: dict[str, Any], of: str | None = None) -> None:
        if doing(self.view, {**step, "name": name, "of": of or self.name}):
            making(self.view, "data", name)
            self.view.set(data=name)
