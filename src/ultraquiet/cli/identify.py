"""`ultraquiet identify`: one record, one method."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from ultraquiet._base.constraints import FloatArray, between
from ultraquiet._base.errors import InputError
from ultraquiet.cli.exits.codes import finish
from ultraquiet.cli.order import chooses, found_order, of_order
from ultraquiet.cli.output.targets import beside, require_free
from ultraquiet.cli.progress import bars
from ultraquiet.cli.settings import completing

if TYPE_CHECKING:
    from ultraquiet.values import Status

HELD_OUT = 0.5


def identify(
    record: Annotated[Path, typer.Argument(help="A record, of any format that `convert` reads.")],
    method: Annotated[
        str,
        typer.Option(
            autocompletion=completing("identify"), help="A registered method; see `ultraquiet methods identify`."
        ),
    ] = "box-jenkins",
    order: Annotated[str | None, typer.Option(help="Order of the model, or auto: what unseen data prefers.")] = None,
    rate: Annotated[float | None, typer.Option(help="Samples per second, when the file does not say.")] = None,
    inputs: Annotated[str | None, typer.Option(help="Names of the inputs in the file, separated by commas.")] = None,
    outputs: Annotated[str | None, typer.Option(help="Names of the outputs in the file, separated by commas.")] = None,
    mapping: Annotated[
        Path | None, typer.Option(help="Channels of the file (TOML), instead of --inputs and --outputs.")
    ] = None,
    hold_out: Annotated[
        float | None,
        typer.Option(
            help=f"Share of the record, at its end, kept for judging the model; without it {HELD_OUT:g}, and nothing "
            "where the order is chosen, which is judged on unseen samples by itself.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Where the model goes (HDF5); default: beside the record.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over an existing model.")] = False,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="Another setting of the method, key=value.")
    ] = None,
) -> None:
    """Identify a model and judge it on the part of the record it has not seen.

    The model is that of the part before; --hold-out 0 takes the whole record, as a call from Python does.
    """
    from ultraquiet import files, validate
    from ultraquiet.cli.output.screen import screen
    from ultraquiet.cli.output.text_table import TextTable
    from ultraquiet.identify.record_checks import in_and_out
    from ultraquiet.values.channel import squared

    settings = of_order(method, setting or (), order)
    kept = hold_out if hold_out is not None else 0.0 if chooses(settings) else HELD_OUT
    held_out_share = between("identify", "hold-out", kept, 0.0, 0.9)
    target = out or beside("identify", record, f"{method}.h5")
    require_free("identify", target, force)
    data = files.read_record(record, rate, _names(inputs), _names(outputs), mapping, keep_clock=True)
    same = in_and_out(data)
    if same:
        raise InputError(f"identify: '{same[0]}' was chosen to go in and to come out; name every column once.")
    cut = data.samples - int(held_out_share * data.samples)
    show = screen()
    with bars():
        result = settings.identify(data.part(0, cut))
    unseen_percent = np.full(len(data.sensors), np.nan)
    if held_out_share:
        unseen_percent = validate.compare(result.model, data.part(cut)).fit_percent
    names = [channel.name for channel in data.sensors]
    missed = _held_out(result.model, unseen_percent, names) if held_out_share else None
    status = missed if missed is not None and result.status.ok else result.status
    files.save(result.model, target, overwrite=force)
    of_all = f" of {data.samples}" if held_out_share else ""
    chosen = found_order(settings, result)
    sized = "" if chosen is None else f" of order {chosen}"
    title = f"{method}{sized} from {cut}{of_all} samples at {data.rate_hz:g} Hz"
    grid = TextTable(("output", "fit, seen", "fit, held out", "loss"), title)
    for channel, seen, unseen, loss in zip(data.sensors, result.fit_percent, unseen_percent, result.loss, strict=True):
        held_out = f"{unseen:.2f} %" if held_out_share else "-"
        grid.add(channel.name, f"{seen:.2f} %", held_out, f"{loss:.4g} {squared(channel.unit)}".strip())
    show.table(grid)
    show.say(result.status, *([] if missed is None else [missed]), f"model: {target}")
    show.result(
        {
            "status": status,
            "model": target,
            "method": method,
            "order": chosen,
            "rate_hz": data.rate_hz,
            "samples": cut,
            "held_out_samples": data.samples - cut,
            "fit_percent": dict(zip(names, result.fit_percent, strict=True)),
            "held_out_fit_percent": dict(zip(names, unseen_percent, strict=True)),
            "loss": dict(zip(names, result.loss, strict=True)),
        }
    )
    finish(status)


def _held_out(model: object, fit_percent: FloatArray, names: list[str]) -> "Status | None":
    """Return what the part not seen says against a model; an unstable one, held by its loop, is not simulated."""
    from ultraquiet.validate.verdict import poor_fit
    from ultraquiet.values import PolynomialMatrix, PolynomialModel, StateSpace, Status

    if not isinstance(model, StateSpace | PolynomialMatrix | PolynomialModel) or not model.is_stable():
        return None
    found = poor_fit(fit_percent, names=names)
    return None if found is None else Status(found.word, f"On the part not seen: {found.sentence}")


def _names(text: str | None) -> list[str] | None:
    return [name.strip() for name in text.split(",")] if text else None
