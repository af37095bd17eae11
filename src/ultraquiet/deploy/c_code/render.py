"""From a law to the text of its files."""

import re
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ultraquiet._base.provenance import versions
from ultraquiet._base.shown.one_line import one_line
from ultraquiet.deploy.c_code.plan import CodePlan
from ultraquiet.deploy.c_code.self_test import LOADS, OPS, SPECIAL, ScriptRow, planted
from ultraquiet.deploy.figures import said
from ultraquiet.deploy.law.law import Law, open_end
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.deploy.toolchain.compiler import FLAGS
from ultraquiet.deploy.toolchain.targets import TARGETS, families

if TYPE_CHECKING:
    import jinja2

VECTOR_STEPS = 256
# What would begin another cell, a link or a tag of a page that holds what people named.
MARKUP, LONGEST_CELL = re.compile(r"\||<(?=[A-Za-z/!?])|\](?=\()"), 2000

# Advisory rules of MISRA C:2012 that the controller's code departs from, and why; no required rule.
DEVIATIONS = {
    "8.9": "tables stand at file scope in a header of their own, where they can be compared with the model",
    "15.5": "guards leave a function early, so that nothing below them runs on a bad argument",
    "19.2": "a union turns the words of a coefficient bank into numbers; any other way needs a library",
}

# Instructions of a Cortex-M a turn spends on pointers and branch, and a state left over on addresses out of reach; ten
# states a turn keep all offsets within the 1020 bytes a load reaches.
TURN_COST, LEFT_OVER_COST, LARGEST_TURN = 4, 12, 10

FILES = {
    "controller.h.j2": "{name}.h",
    "coefficients.h.j2": "{name}_coefficients.h",
    "controller.c.j2": "{name}.c",
    "selftest.c.j2": "{name}_selftest.c",
    "host.c.j2": "{name}_host.c",
    "Makefile.j2": "Makefile",
}


def sources(plan: CodePlan) -> dict[str, str]:
    """Return file name -> text of the C files and the Makefile."""
    name, context = plan.law.name, _context(plan)
    files = {file.format(name=name): render(template, context) for template, file in FILES.items()}
    return files | _around_the_code(name, context)


def _around_the_code(name: str, context: dict[str, Any]) -> dict[str, str]:
    """Return what each family of processors adds: the program around the code, and a linker script for each memory."""
    files: dict[str, str] = {}
    for family, targets in families():
        files[f"{name}_{family.stem}.c"] = render(family.template("harness.c.j2"), context | {"targets": targets})
        for script in dict.fromkeys(target.script for target in targets):
            those = [target for target in targets if target.script == script]
            place = {"targets": those, "memory": those[0].memory or family.memory}
            files[f"{name}_{script}.ld"] = render(family.template("memory.ld.j2"), context | place)
    return files


def readme(law: Law, model_hash: str, tables: dict[str, Any], sentences: list[str], assumptions: str) -> str:
    """Return the text of README.md; `sentences` are the sentences on the law and on its verification."""
    context = {
        **heading(law, model_hash),
        "rows": said(tables),
        "said": sentences,
        "assumptions": assumptions,
        "flags": " ".join(FLAGS),
        "targets": list(TARGETS.values()),
        "deviations": DEVIATIONS,
    }
    return render("README.md.j2", context)


def vectors(law: Law, seed: int = 0) -> str:
    """Return a plain run at full command as CSV: measurements and commands in hexadecimal."""
    twin = Twin(law)
    twin.reset()
    y = np.random.default_rng(seed).uniform(-1.0, 1.0, (law.inputs, VECTOR_STEPS)).astype(law.dtype)
    u = twin.run(y)
    names = [f"y{j}" for j in range(law.inputs)] + [f"u{i}" for i in range(law.outputs)]
    lines = [",".join(names)]
    lines += [",".join(float(v).hex() for v in (*y[:, k], *u[:, k])) for k in range(VECTOR_STEPS)]
    return "\n".join(lines) + "\n"


def constant(value: Any, precision: str) -> str:
    """Return a number as an exact C99 constant.

    >>> constant(np.float32(0.1), "float32")
    '0x1.99999a0000000p-4f'
    """
    text = float(value).hex()
    return text + "f" if precision == "float32" else text


def render(template: str, context: dict[str, Any]) -> str:
    """Return a filled template."""
    return _environment().get_template(template).render(context)


@cache
def _environment() -> "jinja2.Environment":
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader("ultraquiet.deploy"), jinja2.FunctionLoader(_of_a_family)]),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    environment.filters["plain"] = _plain
    return environment


def _plain(text: object) -> str:
    """Return a text that people named as Markdown's plain text on one line: no table, mark-up or control code in it."""
    return MARKUP.sub(r"\\\g<0>", one_line(str(text), LONGEST_CELL))


def _of_a_family(name: str) -> str | None:
    """Return a template that stands in a family's folder, by `Family.template`."""
    folders = {family.folder.name: family.folder for family, _ in families()}
    folder, _, file = name.partition("/")
    path = folders[folder] / file if folder in folders else None
    return path.read_text(encoding="utf-8") if path is not None and path.is_file() else None


def _context(plan: CodePlan) -> dict[str, Any]:
    law = plan.law

    def table(matrix: Any) -> list[list[str]]:
        return [[constant(v, law.precision) for v in row] for row in matrix]

    bits, end = 8 * np.dtype(law.dtype).itemsize, open_end(law.precision)
    suffix = "U" if bits == 32 else "ULL"
    special = {op: f"0x{value:X}{suffix}" for op, value in SPECIAL[law.precision].items()}
    ends = np.cumsum([0, *law.channels]).tolist()
    return {
        "channel_ends": list(pairwise(ends)),
        **heading(law, plan.model_hash),
        "real": "float" if bits == 32 else "double",
        "word": f"uint{bits}_t",
        "ramp_step": constant(law.dtype(1.0) / law.dtype(law.ramp_steps), law.precision),
        "pairs": law.form in ("modal", "delta"),
        "sizes": [len(b) for b in law.blocks],
        "bank": plan.coefficients,
        "sections": _sections(plan),
        "turn_output": _turn(law.states, 1),
        "turn_update": _turn(law.states, 2),
        "limits": table(law.limits),
        "open_ends": ""
        if np.isfinite(law.known_limits).all()
        else f"; {constant(end, law.precision)} where none is known",
        "excitation": table(law.excitation),
        "bits": bits,
        "ops": OPS,
        "script": [_call(row, law.precision) for row in plan.script],
        "crcs": [f"0x{planted(plan.coefficients, kind).crc:08X}U" for kind in range(LOADS)],
        "special": special,
        "flags": " ".join(FLAGS),
        "targets": list(TARGETS.values()),
        "families": families(),
        "scale": constant(2.0**-12 * plan.script[0].scale * 2.0**23, law.precision),
    }


def heading(law: Any, model_hash: str) -> dict[str, Any]:
    """Return what every file of a law says of it, whatever its numbers are."""
    return {
        "law": law,
        "name": law.name,
        "NAME": law.name.upper(),
        "rate": f"{law.rate_hz:g}",
        "version": versions()["ultraquiet"],
        "model_hash": model_hash,
    }


def _turn(states: int, step: int) -> int:
    """Return how many states a turn of an unrolled loop takes: few turns, few states left over."""
    sizes = range(step, LARGEST_TURN + 1, step)
    return min(sizes, key=lambda size: TURN_COST * (states // size) + LEFT_OVER_COST * (states % size))


def _sections(plan: CodePlan) -> list[dict[str, Any]]:
    texts, at = [], 0
    for section in plan.sections:
        rows = [[constant(v, plan.law.precision) for v in row] for row in section.rows]
        texts.append({"label": section.label, "says": section.says, "rows": rows, "at": at})
        at += sum(len(row) for row in rows)
    return texts


def _call(row: ScriptRow, precision: str) -> dict[str, Any]:
    return {
        "op": row.op,
        "count": row.count,
        "scale": constant(row.scale, precision),
        "digest": f"0x{row.digest:08X}U",
    }
