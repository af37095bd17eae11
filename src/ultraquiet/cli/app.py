"""The command line as a whole: its commands, and what an error looks like."""

import sys

import typer

from ultraquiet._base.errors import UltraquietError
from ultraquiet.cli import convert, design, doctor, identify, inspect, methods, records, spectra, study, validate
from ultraquiet.cli.deploy import command as deploy
from ultraquiet.cli.exits.codes import EPILOG, ExitCode, exit_code
from ultraquiet.cli.experiment import command as experiment

app = typer.Typer(
    help="From the first excitation of a vibration-isolation bench to verified controller code.",
    epilog=EPILOG,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
app.command("demo", epilog=EPILOG)(study.demo)
app.command("run", epilog=EPILOG)(study.run)
app.command("report", epilog=EPILOG)(study.report)
app.command("experiment", epilog=EPILOG)(experiment.experiment)
app.command("records", epilog=EPILOG)(records.records)
app.command("identify", epilog=EPILOG)(identify.identify)
app.command("validate", epilog=EPILOG)(validate.validate)
app.command("spectra", epilog=EPILOG)(spectra.spectra)
app.command("design", epilog=EPILOG)(design.design)
app.command("deploy", epilog=EPILOG)(deploy.deploy)
app.command("convert", epilog=EPILOG)(convert.convert)
app.command("inspect", epilog=EPILOG)(inspect.inspect)
app.command("methods", epilog=EPILOG)(methods.methods)
app.command("doctor", epilog=EPILOG)(doctor.doctor)

STOPPED = "ultraquiet: stopped; finished stages and records are kept."


def main() -> None:
    """Run the command line; an error is one sentence on stderr, and the exit code says of which kind."""
    try:
        app()
    except UltraquietError as error:
        print(f"ultraquiet: {error}", file=sys.stderr)
        sys.exit(exit_code(error))
    except SystemExit as stop:
        if stop.code == ExitCode.INTERRUPTED:  # what typer makes of Ctrl-C, without a word
            print(STOPPED, file=sys.stderr)
        raise
    except KeyboardInterrupt as stop:
        print(STOPPED, file=sys.stderr)
        sys.exit(exit_code(stop))
