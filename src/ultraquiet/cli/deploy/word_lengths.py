"""What `ultraquiet deploy` does with word lengths: the table to choose by, and whole-number code."""

from pathlib import Path
from typing import TYPE_CHECKING

from ultraquiet._base.errors import InputError
from ultraquiet.cli.deploy.margins import rounded_loop
from ultraquiet.cli.deploy.ranges import as_typed, requested_limits, requested_range
from ultraquiet.cli.output.screen import screen
from ultraquiet.cli.output.text_table import TextTable

if TYPE_CHECKING:
    from ultraquiet.values import StateSpace, Status

FIXED = ("q31", "q15")
PRECISIONS = ("float32", "float64", *FIXED)
HEADS = (
    "precision",
    "form",
    "status",
    "error",
    "loop louder, dB",
    "bound",
    "noise in commands",
    "multiply-adds",
    "bytes",
)


def refuse_others(precision: str, table: bool, *others: object) -> None:
    """Refuse options that the table, or code of whole numbers, has no use for."""
    what = "--word-lengths writes nothing" if table else f"code in {precision} has no anti-windup and runs here only"
    if any(others):
        raise InputError(
            f"deploy: {what}; leave --anti-windup, --budget, --target, --fmu, --export, --project and --frame away."
        )


def show_word_lengths(
    law: "StateSpace", plant: "StateSpace | None", limits: str | None, reading: str | None
) -> "Status":
    """Print what each precision and form would make of the law, in the loop when a plant is given; return the best."""
    from ultraquiet import deploy
    from ultraquiet.deploy.fixed_point.ranges import cut_short
    from ultraquiet.values.status import StatusWord

    grid = TextTable(HEADS, "word lengths")
    span, ends = requested_range(reading), requested_limits(limits, law)
    compared = deploy.word_lengths(law, plant, input_v=span, output_v=ends)
    for row in compared:
        figures = (row.error, row.degradation_db, row.overflow, row.noise_v, row.multiply_adds, row.coefficient_bytes)
        cells = [
            "-" if value is None else f"{value:.2g}" if isinstance(value, float) else str(value) for value in figures
        ]
        grid.add(row.precision, row.form, row.status.word, *cells)
    screen().table(grid)
    refused = (as_typed(row.status.sentence) for row in compared if row.status.word == StatusWord.REFUSED)
    screen().say(*filter(None, (cut_short(law, ends), *dict.fromkeys(refused))))
    screen().result(compared)
    return min((row.status for row in compared), key=lambda status: not status.ok)


def deploy_fixed(
    law: "StateSpace",
    folder: Path,
    word: str,
    form: str,
    plant: "StateSpace | None",
    steps: int,
    limits: str | None,
    reading: str | None,
) -> "tuple[Status | None, ...]":
    """Generate whole-number C99, compare it with its twin, print one table; return what law, code and loop came to."""
    from ultraquiet import deploy
    from ultraquiet.deploy.figures import said

    span, ends = requested_range(reading), requested_limits(limits, law)
    deployment = deploy.generate_fixed(law, folder, word, form=form, plant=plant, input_v=span, output_v=ends)
    verified = deployment.verify(steps)
    loop = None if plant is None else rounded_loop(plant, deployment.quantised, law)
    grid = TextTable(("what", "value"), f"{folder}")
    for row in said(deployment.tables):
        grid.add(*row)
    show = screen()
    show.table(grid)
    show.say(deployment.status, verified.status, *(() if loop is None else loop.lines))
    kept = None if loop is None else loop.status
    facts = {"folder": folder, "status": deployment.status, "verified": verified.status, "loop": kept}
    show.result({**facts, "tables": deployment.tables})
    return deployment.status, verified.status, kept
