"""`ultraquiet identify`: one record, one method."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ultraquiet._base.constraints import between
from ultraquiet.cli.exits.codes import finish
from ultraquiet.cli.progress import bars
from ultraquiet.cli.settings import method as make

HELD_OUT = 0.5


def identify(
    record: Annotated[Path, typer.Argument(help="A record, of any format that `convert` reads.")],
    method: Annotated[
        str, typer.Option(help="A registered method; see `ultraquiet methods identify`.")
    ] = "box-jenkins",
    order: Annotated[int | None, typer.Option(help="Order of the model.")] = None,
    rate: Annotated[float | None, typer.Option(help="Samples per second, when the file does not say.")] = None,
    inputs: Annotated[str | None, typer.Option(help="Names of the inputs in the file, separated by commas.")] = None,
    outputs: Annotated[str | None, typer.Option(help="Names of the outputs in the file, separated by commas.")] = None,
    mapping: Annotated[
        Path | None, typer.Option(help="Channels of the file (TOML), instead of --inputs and --outputs.")
    ] = None,
    hold_out: Annotated[
        float, typer.Option(help="Share of the record, at its end, kept for judging the model.")
    ] = HELD_OUT,
    out: Annotated[Path | None, typer.Option(help="Where the model goes (HDF5); default: beside the record.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over an existing model.")] = False,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="Another setting of the method, key=value.")
    ] = None,
) -> None:
    """Identify a model and judge it on the part of the record it has not seen."""
    from rich.console import Console
    from rich.table import Table

    from ultraquiet import files, validate

    held_out_share = between("identify", "hold-out", hold_out, 0.0, 0.9)
    data = files.read_record(record, rate, _names(inputs), _names(outputs), mapping)
    settings = make("identify", method, setting or (), order=order)
    cut = data.samples - int(held_out_share * data.samples)
    with bars():
        result = settings.identify(data.part(0, cut))
    unseen_percent = np.full(len(data.sensors), np.nan)
    if held_out_share:
        unseen_percent = validate.compare(result.model, data.part(cut)).fit_percent
    target = out or record.with_name(f"{record.stem}-{method}.h5")
    files.save(result.model, target, overwrite=force)
    table = Table(
        "output", "fit, seen", "fit, held out", "loss", title=f"{method} from {cut} samples at {data.rate_hz:g} Hz"
    )
    for channel, seen, unseen, loss in zip(data.sensors, result.fit_percent, unseen_percent, result.loss, strict=True):
        unit = f" {channel.unit}²" if channel.unit else ""
        table.add_row(channel.name, f"{seen:.2f} %", f"{unseen:.2f} %" if held_out_share else "-", f"{loss:.4g}{unit}")
    console = Console()
    console.print(table)
    console.print(f"{result.status}\nmodel: {target}", highlight=False, soft_wrap=True)
    finish(result.status)


def _names(text: str | None) -> list[str] | None:
    return [name.strip() for name in text.split(",")] if text else None
