"""`ultraquiet convert`: a record from one format to another."""

from pathlib import Path
from typing import Annotated

import typer

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.shown.line import counted


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A record; its suffix says in which format.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="The new file; its suffix says in which format.")],
    mapping: Annotated[
        Path | None, typer.Option(help="Channels (TOML): column, name, unit, scale, offset, limits; rate and cut.")
    ] = None,
    rate_hz: Annotated[
        float | None, typer.Option("--rate-hz", "--rate", help="Samples per second, when the file does not say.")
    ] = None,
    inputs: Annotated[str | None, typer.Option(help="The inputs in the file, separated by commas.")] = None,
    outputs: Annotated[str | None, typer.Option(help="The outputs in the file, separated by commas.")] = None,
    text: Annotated[bool, typer.Option("--text", help="UFF with numbers as text, twelve digits.")] = False,
    response: Annotated[
        bool, typer.Option("--response", help="A frequency response: UFF or NPZ to HDF5 or UFF.")
    ] = False,
    conjugated: Annotated[
        bool, typer.Option("--conjugated", help="Cross spectra of the NPZ are E[u y*], not E[u* y].")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Write over an existing file.")] = False,
) -> None:
    """Convert a record, or a frequency response; channel names, units and the rate are kept."""
    from ultraquiet import files
    from ultraquiet.cli.output.screen import screen

    files.possible(target, "convert")
    if target.exists() and source.exists() and target.samefile(source):
        raise InputError(f"convert: '{target}' is the file that is read; give the new one another name.")
    if not target.parent.is_dir():
        raise StorageError(f"convert: there is no folder '{target.parent}' for '{target.name}'; make it first.")
    if response:
        if mapping or rate_hz is not None or inputs or outputs:
            raise InputError("convert: --response takes no mapping, rate, inputs or outputs.")
        read = files.read_frf(source, conjugated)
        files.export_frf(read, target, overwrite=force, text=text)
        told = []
        wires = f"{counted(len(read.actuators), 'input')} and {counted(len(read.sensors), 'output')}"
        size = f"{wires} at {counted(read.f_hz.size, 'frequency', 'frequencies')}"
    else:
        record = files.read_record(source, rate_hz, inputs, outputs, mapping, keep_clock=True)
        files.export_record(record, target, overwrite=force, text=text)
        size = (
            f"{counted(len(record.actuators), 'input')} and {counted(len(record.sensors), 'output')}, "
            f"{counted(record.samples, 'sample')} at {record.rate_hz:g} Hz"
        )
        sides = (("inputs", record.actuators), ("outputs", record.sensors))
        told = [f"{side}: {', '.join(wire.name for wire in wires)}" for side, wires in sides]
    screen().say(size, *told, f"written: {target}")
    screen().result({"written": target, "holds": size})
