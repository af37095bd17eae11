"""The command line as a whole: its commands, and what an error looks like."""

import sys

import typer

from ultraquiet._base.errors import UltraquietError
from ultraquiet.cli import convert, design, doctor, identify, inspect, methods, records, spectra, study, validate
from ultraquiet.cli.deploy import command as deploy
from ultraquiet.cli.experiment import command as experiment

app = typer.Typer(
    help="From the first excitation of a vibration-isolation bench to verified controller code.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
app.command("demo")(study.demo)
app.command("run")(study.run)
app.command("report")(study.report)
app.command("experiment")(experiment.experiment)
app.command("records")(records.records)
app.command("identify")(identify.identify)
app.command("validate")(validate.validate)
app.command("spectra")(spectra.spectra)
app.command("design")(design.design)
app.command("deploy")(deploy.deploy)
app.command("convert")(convert.convert)
app.command("inspect")(inspect.inspect)
app.command("methods")(methods.methods)
app.command("doctor")(doctor.doctor)

REFUSED, INTERRUPTED = 2, experiment.INTERRUPTED


def main() -> None:
    """Run the command line; bad input is one sentence on stderr and exit code 2."""
    try:
        app()
    except UltraquietError as error:
        print(f"ultraquiet: {error}", file=sys.stderr)
        sys.exit(REFUSED)
    except SystemExit as stop:
        if stop.code == INTERRUPTED:  # what typer makes of Ctrl-C, without a word
            print("ultraquiet: stopped; finished stages and records are kept.", file=sys.stderr)
        raise
