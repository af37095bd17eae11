"""The command line as a whole: its commands, and what an error looks like."""

import sys
from collections.abc import Callable
from typing import Annotated

import typer

from ultraquiet._base.errors import SignalExit, UltraquietError
from ultraquiet._base.provenance import versions
from ultraquiet.cli import convert, design, doctor, identify, inspect, methods, records, study, validate
from ultraquiet.cli.deploy import command as deploy
from ultraquiet.cli.exits.codes import EPILOG, ExitCode, exit_code
from ultraquiet.cli.experiment import command as experiment
from ultraquiet.cli.loop import analyse, campaign, simulate
from ultraquiet.cli.output.options import NoEmptyWords, with_options
from ultraquiet.cli.output.screen import harmless
from ultraquiet.cli.spectra import command as spectra
from ultraquiet.cli.workbench import command as workbench

COMMANDS: dict[str, Callable[..., None]] = {
    "demo": study.demo,
    "run": study.run,
    "report": study.report,
    "experiment": experiment.experiment,
    "records": records.records,
    "identify": identify.identify,
    "validate": validate.validate,
    "spectra": spectra.spectra,
    "design": design.design,
    "analyse": analyse.analyse,
    "simulate": simulate.simulate,
    "campaign": campaign.campaign,
    "deploy": deploy.deploy,
    "convert": convert.convert,
    "inspect": inspect.inspect,
    "serve": workbench.serve,
    "methods": methods.methods,
    "doctor": doctor.doctor,
}

app = typer.Typer(
    help="From the first excitation of a vibration-isolation bench to verified controller code.",
    epilog=EPILOG,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,  # square brackets are words here, not markup
)
for _name, _command in COMMANDS.items():
    app.command(_name, epilog=EPILOG, cls=NoEmptyWords)(with_options(_command))


def _version(asked: bool) -> None:
    if asked:
        sys.stdout.write(f"ultraquiet {versions()['ultraquiet']}\n")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


STOPPED = "ultraquiet: stopped; finished stages and records are kept."


def _tell(sentence: str) -> None:
    """Print a sentence on stderr; what it quotes of a file's content or name commands no terminal."""
    print(f"ultraquiet: {harmless(sentence)}", file=sys.stderr)


def main() -> None:
    """Run the command line; an error is one sentence on stderr, and the exit code says of which kind."""
    try:
        app()
    except UltraquietError as error:
        _tell(str(error))
        sys.exit(exit_code(error))
    except OSError as error:  # of the system and its disks, wherever it is met
        from ultraquiet.files import reason

        named = f"'{error.filename}' cannot be read or written" if error.filename else "the system refused"
        _tell(f"{named} ({reason(error)}).")
        sys.exit(ExitCode.REFUSED)
    except MemoryError as error:
        print(f"ultraquiet: this asks for more memory than there is; ask for less ({error}).", file=sys.stderr)
        sys.exit(ExitCode.REFUSED)
    except (Exception, SystemExit) as error:
        # no bench of one's own was made where nobody imported what makes them
        maker = sys.modules.get("ultraquiet.bench.from_file")
        said = maker and maker.of_a_bench(error)
        if said:
            _tell(f"bench: {said}")
            sys.exit(ExitCode.REFUSED)
        interrupted = isinstance(error, SystemExit) and error.code == ExitCode.INTERRUPTED  # typer's of Ctrl-C
        if interrupted or isinstance(error, SignalExit):  # neither says a word
            print(STOPPED, file=sys.stderr)
            sys.exit(ExitCode.INTERRUPTED)  # by whichever signal a guarded bench was brought to rest
        raise
    except KeyboardInterrupt as stop:
        print(STOPPED, file=sys.stderr)
        sys.exit(exit_code(stop))
