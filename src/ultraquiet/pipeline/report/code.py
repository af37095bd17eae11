"""What the report says of the code of laws."""

from collections.abc import Sequence

from ultraquiet.deploy.figures import figure_text, figure_words
from ultraquiet.deploy.toolchain.targets import TARGETS, target_named
from ultraquiet.pipeline.facts.code import CodeFacts, NoCode, WholeNumberFacts
from ultraquiet.pipeline.report.loops import reductions
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.report import Section, Table

C31_COLUMNS = ("c31_cycles", "c31_budget")
WHOLE_NUMBER_COLUMNS = ("scaling", "state_bound", "accumulator_bound", "noise_v", "noise_bound_v", "multiply_adds")


def code(result: StudyResult) -> Section:
    """The generated code of each controller."""
    asked = result.study.deploy
    paper = result.study.paper is not None and result.study.paper.processor == "c31"
    c31 = (paper or "c31" in asked.targets) and not asked.whole_numbers
    columns = _columns(result, c31)
    rows = [(name, *(_of_code(facts, column) for column in columns)) for name, facts in result.deployment.items()]
    heads = ("controller", *map(figure_words, columns))
    sentences = [f"{name}: {facts.verdict}" for name, facts in result.deployment.items()]
    sentences += [*_of_vectors(result), *_of_ranges(result)]
    note = "C31 cycles come from a model of the processor: a law fits the model, it has not run on the processor."
    failed = [name for name, facts in result.deployment.items() if facts.failed]
    reduced = reductions(result)
    beside = "; what a reduction left of each law stands beside it" if reduced else ""
    text = (
        f"The code of {', '.join(failed)} is not ok, or there is none; see below."
        if failed
        else f"The code of every law was compiled and compared with its twin{beside}."
    )
    tables = [Table("Generated C99", heads, rows), *_word_lengths(result), *reduced]
    return Section("Code", [text, note] if c31 else [text], tables, [], sentences)


def _columns(result: StudyResult, c31: bool) -> tuple[str, ...]:
    """Return the figures that stand in the table, by what the study asks of the code."""
    asked = result.study.deploy
    if asked.whole_numbers:
        return ("states", "form", *WHOLE_NUMBER_COLUMNS, "bit_exact")
    counted = map(_instructions, asked.processors)
    return ("states", "form", *(C31_COLUMNS if c31 else ()), *counted, "flash_bytes", "ram_bytes", "bit_exact")


def _of_vectors(result: StudyResult) -> list[str]:
    """Say of each law's C31 assembly how far its vectors go."""
    codes = {name: facts for name, facts in result.deployment.items() if isinstance(facts, CodeFacts)}
    return [f"{name}, C31 test vectors: {facts.c31_vectors}." for name, facts in codes.items() if facts.c31_vectors]


def _of_ranges(result: StudyResult) -> list[str]:
    """Say of code of whole numbers what its words are held to."""
    codes = {name: facts for name, facts in result.deployment.items() if isinstance(facts, WholeNumberFacts)}
    return [
        f"{name}, ranges of its words: readings {', '.join(facts.measurements)}; commands {', '.join(facts.commands)}."
        for name, facts in codes.items()
    ]


def _word_lengths(result: StudyResult) -> list[Table]:
    """Return the words that every law's code computes in, and what they cost; nothing where there is no code."""
    codes = {
        name: facts for name, facts in result.deployment.items() if isinstance(facts, CodeFacts | WholeNumberFacts)
    }
    columns = _formats(list(codes.values()))
    rows: list[tuple[object, ...]] = []
    for k, (name, facts) in enumerate(codes.items()):
        held = sum(kept.bits for kept in facts.word_formats if kept.quantity == "coefficients") // 8
        figures = (facts.coefficients, facts.coefficients * held, figure_text(facts.response_error))
        rows.append((name, facts.precision, *(words[k] for _, words in columns), *figures))
    size, error = figure_words("coefficient_bytes"), figure_words("response_error")
    heads = (
        "controller",
        figure_words("precision"),
        *(what for what, _ in columns),
        "coefficients, how many",
        size,
        error,
    )
    caption = "Word lengths of the code; the error is of the loop's sensitivity on the design model, over its size"
    return [Table(caption, heads, rows)] if columns else []


def _formats(codes: Sequence[CodeFacts | WholeNumberFacts]) -> list[tuple[str, tuple[str, ...]]]:
    """Return quantities and their format in each law's code; those that are alike in every code stand together."""
    alike: dict[tuple[str, ...], list[str]] = {}
    for quantity in dict.fromkeys(kept.quantity for facts in codes for kept in facts.word_formats):
        each = ({kept.quantity: kept.words for kept in facts.word_formats} for facts in codes)
        alike.setdefault(tuple(words.get(quantity, "-") for words in each), []).append(quantity)
    return [(", ".join(quantities), words) for words, quantities in alike.items()]


def _of_code(facts: CodeFacts | WholeNumberFacts | NoCode, column: str) -> str:
    """Return one fact of a law's code as its cell says it."""
    on = (facts.instructions_on if isinstance(facts, CodeFacts) else None) or {}
    counts = {_instructions(name): on[name] for name in TARGETS if name in on}
    return figure_text(counts.get(column, getattr(facts, column, None)))


def _instructions(processor: str) -> str:
    """Return the name that the count of a processor has among the figures of a law's code."""
    return f"{target_named(processor).key}_instructions"
