"""What `ultraquiet deploy` does with word lengths: the table to choose by, and whole-number code."""

from pathlib import Path
from typing import TYPE_CHECKING

from ultraquiet._base.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from ultraquiet.values import StateSpace, Status

FIXED = ("q31", "q15")
HEADS = ("precision", "form", "status", "error", "loop louder, dB", "bound", "noise, V", "multiply-adds", "bytes")


def refuse_others(precision: str, table: bool, *others: object) -> None:
    """Refuse options that the table, or code of whole numbers, has no use for."""
    what = "--word-lengths writes nothing" if table else f"code in {precision} has no anti-windup and runs here only"
    if any(others):
        raise InputError(
            f"deploy: {what}; leave --anti-windup, --budget, --target, --fmu, --export, --project and --frame away."
        )


def show_word_lengths(console: "Console", law: "StateSpace", plant: "StateSpace | None") -> "Status":
    """Print what each precision and form would make of the law, in the loop when a plant is given; return the best."""
    from rich.table import Table

    from ultraquiet import deploy

    table = Table(*HEADS, title="word lengths")
    compared = deploy.word_lengths(law, plant)
    for row in compared:
        figures = (row.error, row.degradation_db, row.overflow, row.noise_v, row.multiply_adds, row.coefficient_bytes)
        cells = [
            "-" if value is None else f"{value:.2g}" if isinstance(value, float) else str(value) for value in figures
        ]
        table.add_row(row.precision, row.form, row.status.word, *cells)
    console.print(table)
    return min((row.status for row in compared), key=lambda status: not status.ok)


def deploy_fixed(
    console: "Console", law: "StateSpace", folder: Path, word: str, form: str, plant: "StateSpace | None", steps: int
) -> "tuple[Status, Status]":
    """Generate whole-number C99, compare it with its twin, print one table; return what law and code came to."""
    from rich.table import Table

    from ultraquiet import deploy

    deployment = deploy.generate_fixed(law, folder, word, form=form, plant=plant)
    verified = deployment.verify(steps)
    table = Table("what", "value", title=f"{folder}")
    for key, value in deployment.tables.items():
        table.add_row(key.replace("_", " "), f"{value:.3g}" if isinstance(value, float) else str(value))
    console.print(table)
    for status in (deployment.status, verified.status):
        console.print(str(status), highlight=False, soft_wrap=True)
    return deployment.status, verified.status
