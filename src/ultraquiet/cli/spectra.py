"""`ultraquiet spectra`: densities, responses, transmissibility, octaves and criteria of a record."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ultraquiet._base.constraints import one_of, positive
from ultraquiet._base.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from ultraquiet._base.constraints import FloatArray
    from ultraquiet.plot import Figure
    from ultraquiet.spectra import BandLevels
    from ultraquiet.values import Record

    _Told = tuple[list[Table], Figure, list[str]]

# So many channels stand beside each other in a terminal of 80 columns.
ABREAST = 4


@dataclass(frozen=True)
class _Wanted:
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
        str | None, typer.Option(help="Unit of the outputs, when the file does not say: m/s, g, ...")
    ] = None,
    sensitivity: Annotated[float | None, typer.Option(help="Volts per unit; the outputs are divided by it.")] = None,
    out: Annotated[Path | None, typer.Option(help="Where the picture goes (SVG).")] = None,
) -> None:
    """Estimate spectra of a record; what was averaged, and how, is said with every result."""
    from rich.console import Console

    from ultraquiet import files
    from ultraquiet.plot import draw_svg

    kinds: dict[str, Callable[[Record, _Wanted], _Told]] = {
        "density": _density, "response": _response, "transmissibility": _transmissibility, "octaves": _octaves,
    }  # fmt: skip
    one_of("spectra", "show", show, tuple(kinds))
    if out is not None and out.suffix.lower() != ".svg":
        raise InputError(f"spectra: '--out' must end in .svg, the one kind of picture that is drawn, got '{out}'.")
    data = _scaled(files.read_record(record, rate, inputs, outputs, mapping), unit, sensitivity)
    averaging = {"segment_samples": segment, "overlap": overlap, "window": window, "detrend": detrend}
    wanted = _Wanted(averaging, estimator, base, payload, fraction, quantity)
    tables, figure, words = kinds[show](data, wanted)
    if out is not None:
        files.write_bytes(out, draw_svg(figure).encode())
        words.append(f"picture: {out}")
    console = Console()
    for table in tables:
        console.print(table)
    console.print("\n".join(words), highlight=False, soft_wrap=True)


def _scaled(data: "Record", unit: str | None, sensitivity: float | None) -> "Record":
    from ultraquiet.values import Channel, Record

    divisor = 1.0 if sensitivity is None else positive("spectra", "sensitivity", sensitivity)
    if sensitivity is not None and unit is None:
        raise InputError("spectra: '--sensitivity' needs '--unit', the unit it turns volts into (for instance m/s).")
    sensors = [c if unit is None else Channel(c.name, unit) for c in data.sensors]
    return Record(data.inputs, data.outputs / divisor, data.rate_hz, data.actuators, sensors, data.provenance)


def _density(data: "Record", wanted: _Wanted) -> "_Told":
    import numpy as np
    from rich.table import Table

    from ultraquiet import spectra as room
    from ultraquiet.plot.spectra import density_figure

    found = room.psd(data, **wanted.averaging)
    table = Table("channel", "rms", "strongest line", "density there", "95 % interval", title="Power spectral density")
    low, high = found.interval()
    total = found.rms()
    for k, channel in enumerate(found.channels):
        at = int(np.argmax(found.values[k]))
        span = f"{low[k, at]:.3g} to {high[k, at]:.3g}"
        density = f"{found.values[k, at]:.4g} ({channel.unit})²/Hz"
        table.add_row(channel.name, f"{total[k]:.4g} {channel.unit}", f"{found.f_hz[at]:.4g} Hz", density, span)
    return [table], density_figure(found), [found.estimator]


def _response(data: "Record", wanted: _Wanted) -> "_Told":
    import numpy as np
    from rich.table import Table

    from ultraquiet import spectra as room
    from ultraquiet.plot.spectra import response_figure

    found = room.frf(data, estimator=wanted.estimator, **wanted.averaging)
    assert found.coherence is not None
    table = Table("output", "input", "largest gain", "at", "median coherence", title="Frequency response")
    for i, sensor in enumerate(found.sensors):
        for j, actuator in enumerate(found.actuators):
            at = _strongest(np.abs(found.values[i, j]), found.coherence[i, j], found.f_hz)
            told = ("-", "-") if at is None else (f"{found.magnitude_db[i, j, at]:.2f} dB", f"{found.f_hz[at]:.4g} Hz")
            table.add_row(sensor.name, actuator.name, *told, f"{np.median(found.coherence[i, j]):.3f}")
    return [table], response_figure(found), [found.estimator, _where()]


def _transmissibility(data: "Record", wanted: _Wanted) -> "_Told":
    from rich.table import Table

    from ultraquiet import spectra as room
    from ultraquiet.plot.spectra import transmissibility_figure

    if wanted.base is None or wanted.payload is None:
        names = ", ".join(c.name for c in data.sensors)
        raise InputError(f"spectra: transmissibility needs '--base' and '--payload', sensors among {names}.")
    sides = [[name.strip() for name in side.split(",")] for side in (wanted.base, wanted.payload)]
    found = room.transmissibility(data, sides[0], sides[1], estimator=wanted.estimator, **wanted.averaging)
    table = Table("payload", "base", "largest", "at", "95 % interval", title="Transmissibility")
    low, high = found.interval_db()
    coherence = found.response.coherence
    assert coherence is not None
    for i, p in enumerate(found.response.sensors):
        for j, b in enumerate(found.response.actuators):
            at = _strongest(found.db[i, j], coherence[i, j], found.f_hz)
            told = ("-", "-", "-")
            if at is not None:
                span = f"{low[i, j, at]:.2f} to {high[i, j, at]:.2f} dB"
                told = f"{found.db[i, j, at]:.2f} dB", f"{found.f_hz[at]:.4g} Hz", span
            table.add_row(p.name, b.name, *told)
    return [table], transmissibility_figure(found), [found.estimator, _where()]


def _strongest(gain: "FloatArray", coherence: "FloatArray", f_hz: "FloatArray") -> int | None:
    """Return the line of the largest gain among those that can be trusted; what detrending leaves at 0 Hz cannot."""
    import numpy as np

    from ultraquiet.spectra.coherence import TRUSTED

    trusted = (coherence > TRUSTED) & (f_hz > 0)
    return int(np.argmax(np.where(trusted, gain, -np.inf))) if trusted.any() else None


def _where() -> str:
    from ultraquiet.spectra.coherence import TRUSTED

    return f"largest among the lines with a coherence above {TRUSTED:g}"


def _octaves(data: "Record", wanted: _Wanted) -> "_Told":
    from rich.table import Table

    from ultraquiet import spectra as room
    from ultraquiet.plot.spectra import bands_figure

    found = room.psd(data, **wanted.averaging)
    if wanted.quantity is not None:
        found = room.convert_spectrum(found, wanted.quantity, "velocity")
    levels = room.band_levels(found, wanted.fraction)
    tables: list[Table] = []
    for first in range(0, len(levels.channels), ABREAST):
        part = slice(first, first + ABREAST)
        heads = (f"{c.name} ({c.unit})" if c.unit else c.name for c in levels.channels[part])
        tables.append(Table("band", *heads, title=f"1/{levels.bands.fraction} octaves, rms"))
        for k, name in enumerate(levels.bands.nominal_hz):
            tables[-1].add_row(f"{name:g} Hz", *(f"{value:.4g}" for value in levels.rms[part, k]))
    return tables, bands_figure(levels), [levels.estimator, *_judged(levels)]


def _judged(levels: "BandLevels") -> Sequence[str]:
    """Return which criteria are met, or why nobody can say."""
    from ultraquiet import spectra as room

    try:
        return room.classify(levels).sentences
    except InputError as error:
        return [f"no vibration criterion: {str(error).removeprefix('classify: ')}"]
