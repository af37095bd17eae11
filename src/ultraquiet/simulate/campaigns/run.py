"""A campaign from its first case to its table."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.constraints import whole
from ultraquiet._base.progress import task
from ultraquiet.simulate.campaigns.drawing import WHO
from ultraquiet.simulate.campaigns.evaluation import Campaign, Row
from ultraquiet.simulate.campaigns.executors import require_portable, results
from ultraquiet.simulate.campaigns.ledger import Ledger, digest_of


def run_campaign(
    campaign: Campaign,
    cases: int,
    ledger: Path,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    resume: bool = False,
) -> list[Row]:
    """Evaluate the cases 0 to `cases` - 1 and return their rows, by case.

    Args:
        campaign: what is evaluated.
        cases: how many benches.
        ledger: the file in which each result is sealed as it comes.
        workers: processes; as many as cores when absent.
        cluster: None for this machine's cores; "local" for a Dask cluster here, or a scheduler's address.
        resume: go on with the results that are there.

    The table is the same whichever way it was made, and after however many interruptions.
    """
    whole(WHO, "cases", cases, 1)
    with Ledger(ledger, campaign.digest, resume) as sealed, task("benches", cases) as progress:
        missing = [case for case in range(cases) if case not in sealed.rows]
        progress.advance(cases - len(missing), note="sealed before")
        if workers != 1 or cluster is not None:
            for _, bench in campaign.units:
                require_portable(bench)
        for row in results(partial(_evaluated, campaign), missing, workers, cluster):
            sealed.add(row)
            progress.advance(note=f"case {row['case']}")
        return [sealed.rows[case] for case in range(cases)]


def is_of(campaign: Campaign, ledger: Path) -> bool:
    """Tell whether a file holds results of a campaign."""
    return ledger.exists() and digest_of(ledger) == campaign.digest


def _evaluated(campaign: Campaign, case: int) -> Row:
    return {name: _plain(value) for name, value in campaign.evaluate(case).items()}


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def columns(rows: list[Row]) -> Mapping[str, list[Any]]:
    """Return rows as columns; what a row does not have is None there."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name) for row in rows] for name in names}


def write_table(rows: list[Row], path: Path) -> Path:
    """Write rows as a Parquet file, whole or not at all."""
    import pyarrow as pa
    from pyarrow import parquet

    from ultraquiet.files import write_bytes

    sink = pa.BufferOutputStream()
    parquet.write_table(pa.table(dict(columns(rows))), sink)
    return write_bytes(path, sink.getvalue().to_pybytes())
