"""`ultraquiet spectra`: densities, responses, transmissibility, octaves and criteria of a record."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ultraquiet._base.constraints import one_of, positive
from ultraquiet._base.errors import InputError
from ultraquiet.cli.output.pictures import FORMATS, format_of_picture, picture_bytes
from ultraquiet.cli.output.screen import screen
from ultraquiet.cli.output.targets import require_free
from ultraquiet.cli.output.text_table import TextTable
from ultraquiet.values.channel import ratio, same_unit, squared

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ultraquiet._base.constraints import FloatArray
    from ultraquiet.plot import Figure
    from ultraquiet.spectra import BandLevels
    from ultraquiet.values import FrequencyResponse, Record

    BoolArray = NDArray[np.bool_]

    _Display = tuple[list[TextTable], Figure, list[str]]

# So many channels stand beside each other in a terminal of 80 columns.
ABREAST = 4


@dataclass(frozen=True)
class _Request:
    """What the words of the command line ask for."""

    averaging: dict[str, Any]
    estimator: str
    base: str | None
    payload: str | None
    fraction: int
    quantity: str | None


def spectra(
    record: Annotated[Path, typer.Argument(help="A record, of any format that `convert` reads.")],
    show: Annotated[str, typer.Option(help="density, response, transmissibility or octaves.")] = "density",
    rate: Annotated[float | None, typer.Option(help="Samples per second, when the file does not say.")] = None,
    inputs: Annotated[str | None, typer.Option(help="The inputs in the file, separated by commas.")] = None,
    outputs: Annotated[str | None, typer.Option(help="The outputs in the file, separated by commas.")] = None,
    mapping: Annotated[
        Path | None, typer.Option(help="Channels of the file (TOML), instead of --inputs and --outputs.")
    ] = None,
    segment: Annotated[int | None, typer.Option(help="Samples in a segment; default: an eighth of the record.")] = None,
    overlap: Annotated[float, typer.Option(help="Shared part of neighbouring segments.")] = 0.5,
    window: Annotated[str, typer.Option(help="A window of scipy.signal.")] = "hann",
    detrend: Annotated[str, typer.Option(help="constant, linear or none.")] = "constant",
    estimator: Annotated[str, typer.Option(help="H1, H2, Hv; for transmissibility also reference.")] = "H1",
    base: Annotated[str | None, typer.Option(help="Sensors on the base, separated by commas.")] = None,
    payload: Annotated[str | None, typer.Option(help="Sensors on the payload, separated by commas.")] = None,
    fraction: Annotated[int, typer.Option(help="Bands per octave.")] = 3,
    quantity: Annotated[
        str | None, typer.Option(help="What the sensors read: displacement, velocity or acceleration.")
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(help="Unit of the outputs, when the file does not say, or --sensitivity makes one: m/s, g, ..."),
    ] = None,
    sensitivity: Annotated[
        float | None, typer.Option(help="What a sensor reads per unit; the outputs are divided by it.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Where the picture goes (.svg or .png).")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over an existing picture.")] = False,
) -> None:
    """Estimate spectra of a record; what was averaged, and how, is said with every result."""
    from ultraquiet import files

    kinds: dict[str, Callable[[Record, _Request], _Display]] = {
        "density": _density, "response": _response, "transmissibility": _transmissibility, "octaves": _octaves,
    }  # fmt: skip
    one_of("spectra", "show", show, tuple(kinds))
    form = None if out is None else format_of_picture("spectra", out)
    if out is not None:
        require_free("spectra", out, force, tuple(f".{each}" for each in FORMATS))
    data = _scaled(files.read_record(record, rate, inputs, outputs, mapping, keep_clock=True), unit, sensitivity)
    averaging = {"segment_samples": segment, "overlap": overlap, "window": window, "detrend": detrend}
    request = _Request(averaging, estimator, base, payload, fraction, quantity)
    tables, figure, words = kinds[show](data, request)
    if out is not None and form is not None:
        files.write_bytes(out, picture_bytes(figure, form), overwrite=force)
        words.append(f"picture: {out}")
    printed = screen()
    for table in tables:
        printed.table(table)
    printed.say(*words)
    printed.result({"show": show, "rows": [row for table in tables for row in table.records()], "notes": words})


def _scaled(data: "Record", unit: str | None, sensitivity: float | None) -> "Record":
    from ultraquiet.values import Channel, Record

    divisor = 1.0 if sensitivity is None else positive("spectra", "sensitivity", sensitivity)
    if sensitivity is not None and unit is None:
        raise InputError("spectra: '--sensitivity' needs '--unit', the unit it turns readings into (for instance m/s).")
    if sensitivity is None and unit is not None:
        _agreed(data, unit)
    sensors = [c if unit is None else Channel(c.name, unit) for c in data.sensors]
    return Record(data.inputs, data.outputs / divisor, data.rate_hz, data.actuators, sensors, data.provenance)


def _agreed(data: "Record", unit: str) -> None:
    """Refuse a unit that contradicts the one that an output has already: its numbers would stay as they are."""
    other = next((c for c in data.sensors if c.unit and not same_unit(c.unit, unit)), None)
    if other is not None:
        raise InputError(
            f"spectra: '{other.name}' is recorded in {other.unit}, which '--unit {unit}' contradicts; leave it away, "
            f"or give '--sensitivity', how many {other.unit} one {unit} reads as."
        )


def _density(data: "Record", request: _Request) -> "_Display":
    import numpy as np

    from ultraquiet import spectra as room
    from ultraquiet.plot.spectra import density_figure

    spectrum = room.psd(data, **request.averaging)
    table = TextTable(("channel", "rms", "strongest line", "density there", "95 % interval"), "Power spectral density")
    low, high = spectrum.interval()
    total = spectrum.rms()
    for k, channel in enumerate(spectrum.channels):
        peak = int(np.argmax(spectrum.values[k]))
        span = f"{low[k, peak]:.3g} to {high[k, peak]:.3g}"
        density = f"{spectrum.values[k, peak]:.4g} {squared(channel.unit) or 1}/Hz"
        table.add(channel.name, channel.in_unit(total[k], 4), f"{spectrum.f_hz[peak]:.4g} Hz", density, span)
    return [table], density_figure(spectrum), [spectrum.estimator]


def _response(data: "Record", request: _Request) -> "_Display":
    import numpy as np

    from ultraquiet import spectra as room
    from ultraquiet.plot.spectra import response_figure

    response = room.frf(data, estimator=request.estimator, **request.averaging)
    assert response.coherence is not None
    excited = _excited(data, request, response)
    table = TextTable(("output", "input", "largest gain", "re", "at", "median coherence"), "Frequency response")
    for i, sensor in enumerate(response.sensors):
        for j, actuator in enumerate(response.actuators):
            peak = _strongest(np.abs(response.values[i, j]), response.coherence[i, j], excited[j])
            reference = ratio(sensor.unit, actuator.unit)
            cells = (
                ("-", reference, "-")
                if peak is None
                else (f"{response.magnitude_db[i, j, peak]:.2f} dB", reference, f"{response.f_hz[peak]:.4g} Hz")
            )
            coherence = response.coherence[i, j][excited[j]]
            table.add(sensor.name, actuator.name, *cells, f"{np.median(coherence):.3f}" if coherence.size else "-")
    return [table], response_figure(response), [response.estimator, _where()]


def _transmissibility(data: "Record", request: _Request) -> "_Display":
    from ultraquiet import spectra as room
    from ultraquiet.plot.spectra import transmissibility_figure

    if request.base is None or request.payload is None:
        names = ", ".join(c.name for c in data.sensors)
        raise InputError(f"spectra: transmissibility needs '--base' and '--payload', sensors among {names}.")
    sides = [[name.strip() for name in side.split(",")] for side in (request.base, request.payload)]
    transmissibility = room.transmissibility(data, sides[0], sides[1], estimator=request.estimator, **request.averaging)
    table = TextTable(("payload", "base", "largest", "at", "95 % interval"), "Transmissibility")
    low, high = transmissibility.interval_db()
    coherence = transmissibility.response.coherence
    assert coherence is not None
    for i, p in enumerate(transmissibility.response.sensors):
        for j, b in enumerate(transmissibility.response.actuators):
            peak = _strongest(transmissibility.db[i, j], coherence[i, j], transmissibility.f_hz > 0)
            cells = ("-", "-", "-")
            if peak is not None:
                span = f"{low[i, j, peak]:.2f} to {high[i, j, peak]:.2f} dB"
                cells = f"{transmissibility.db[i, j, peak]:.2f} dB", f"{transmissibility.f_hz[peak]:.4g} Hz", span
            table.add(p.name, b.name, *cells)
    return [table], transmissibility_figure(transmissibility), [transmissibility.estimator, _where()]


def _excited(data: "Record", request: _Request, response: "FrequencyResponse") -> "BoolArray":
    """Return at which lines of a response each of its inputs was excited, `(inputs, nf)`."""
    import numpy as np

    from ultraquiet import spectra as room
    from ultraquiet.spectra.excited import excited_lines

    cross = room.cross_spectra(data, **request.averaging)
    rows = [cross.actuators.index(actuator) for actuator in response.actuators]
    return excited_lines(cross)[rows][:, np.isin(cross.f_hz, response.f_hz)]


def _strongest(gain: "FloatArray", coherence: "FloatArray", counted: "BoolArray") -> int | None:
    """Return the line of the largest gain among those that count and can be trusted."""
    import numpy as np

    from ultraquiet.spectra.coherence import TRUSTED

    trusted = (coherence > TRUSTED) & counted
    return int(np.argmax(np.where(trusted, gain, -np.inf))) if trusted.any() else None


def _where() -> str:
    from ultraquiet.spectra.coherence import TRUSTED

    return f"largest among the excited lines with a coherence above {TRUSTED:g}"


def _octaves(data: "Record", request: _Request) -> "_Display":
    from ultraquiet import spectra as room
    from ultraquiet.plot.spectra import bands_figure

    spectrum = room.psd(data, **request.averaging)
    if request.quantity is not None:
        spectrum = room.convert_spectrum(spectrum, request.quantity, "velocity")
    levels = room.band_levels(spectrum, request.fraction)
    tables: list[TextTable] = []
    for first in range(0, len(levels.channels), ABREAST):
        part = slice(first, first + ABREAST)
        heads = (c.label for c in levels.channels[part])
        tables.append(TextTable(("band", *heads), f"1/{levels.bands.fraction} octaves, rms"))
        for k, name in enumerate(levels.bands.nominal_hz):
            tables[-1].add(f"{name:g} Hz", *(f"{value:.4g}" for value in levels.rms[part, k]))
    return tables, bands_figure(levels), [levels.estimator, *_judged(levels)]


def _judged(levels: "BandLevels") -> Sequence[str]:
    """Return which criteria are met, or why nobody can say."""
    from ultraquiet import spectra as room

    try:
        return room.classify(levels).sentences
    except InputError as error:
        return [f"no vibration criterion: {str(error).removeprefix('classify: ')}"]
