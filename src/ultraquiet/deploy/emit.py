"""From a law to the text of its files."""

from functools import cache
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from ultraquiet.deploy.biquad import sections
from ultraquiet.deploy.law import Law
from ultraquiet.deploy.script import OPS, SPECIAL, Row
from ultraquiet.deploy.targets import CORTEX_M7, TARGETS
from ultraquiet.deploy.twin import Twin

if TYPE_CHECKING:
    import jinja2

M7_FLAGS = CORTEX_M7.flags
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror")
VECTOR_STEPS = 256

FILES = {
    "controller.h.j2": "{name}.h",
    "coefficients.h.j2": "{name}_coefficients.h",
    "controller.c.j2": "{name}.c",
    "selftest.c.j2": "{name}_selftest.c",
    "host.c.j2": "{name}_host.c",
    "cortex.c.j2": "{name}_cortex.c",
    "cortex.ld.j2": "{name}_cortex.ld",
    "Makefile.j2": "Makefile",
}


def sources(law: Law, script: list[Row], model_hash: str) -> dict[str, str]:
    """Return file name -> text of the C files and the Makefile."""
    context = _context(law, script, model_hash)
    return {file.format(name=law.name): render(template, context) for template, file in FILES.items()}


def readme(law: Law, model_hash: str, tables: dict[str, Any], said: list[str], assumptions: str) -> str:
    """Return the text of README.md; `said` are the sentences on the law and on its verification."""
    context = {
        "law": law,
        "name": law.name,
        "rate": f"{law.rate_hz:g}",
        "rows": [(key.replace("_", " "), _plain(value)) for key, value in tables.items()],
        "model_hash": model_hash,
        "said": said,
        "assumptions": assumptions,
        "flags": " ".join(FLAGS),
    }
    return render("README.md.j2", context)


def _plain(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(each)}" for key, each in value.items())
    return f"{value:.2g}" if isinstance(value, float) else str(value)


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

    return jinja2.Environment(
        loader=jinja2.PackageLoader("ultraquiet.deploy"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )


def _context(law: Law, script: list[Row], model_hash: str) -> dict[str, Any]:
    def table(matrix: Any) -> list[list[str]]:
        return [[constant(v, law.precision) for v in row] for row in matrix]

    pairs = law.form in ("modal", "delta", "bank", "bank-delta")
    flat = [block.ravel() for block in law.blocks]
    bits = 8 * np.dtype(law.dtype).itemsize
    suffix = "U" if bits == 32 else "ULL"
    special = {op: f"0x{value:X}{suffix}" for op, value in SPECIAL[law.precision].items()}
    ends = np.cumsum([0, *law.channels]).tolist()
    B, C, D, L = law.B, law.C.T, law.D, law.L
    if law.channels:
        B, C, D = sections(law)
        B, C, D = B.reshape(-1, 2), C.reshape(-1, 2), D[None]
        L = L if L is None or law.turned else L.sum(axis=1).reshape(-1, 2)  # one number a row, the others zero
    return {
        "channels": list(zip(ends, ends[1:], strict=False)),
        "turn_in": None if law.turn_in is None else table(law.turn_in),
        "turn_out": None if law.turn_out is None else table(law.turn_out),
        "law": law,
        "name": law.name,
        "NAME": law.name.upper(),
        "rate": f"{law.rate_hz:g}",
        "version": metadata.version("ultraquiet"),
        "real": "float" if bits == 32 else "double",
        "real_max": constant(np.finfo(law.dtype).max, law.precision),
        "ramp_step": constant(law.dtype(1.0) / law.dtype(law.ramp_steps), law.precision),
        "model_hash": model_hash,
        "pairs": pairs,
        "sizes": [len(b) for b in law.blocks],
        "A": table(flat) if pairs else [constant(v, law.precision) for block in flat for v in block],
        "B": table(B),
        "C": table(C),
        "D": table(D),
        "L": None if L is None else table(L),
        "limits": table(law.limits),
        "bits": bits,
        "ops": OPS,
        "script": [_call(row, law.precision) for row in script],
        "nan_bits": special["NOT_A_NUMBER"],
        "inf_bits": special["INFINITE"],
        "minus_inf_bits": special["MINUS_INFINITE"],
        "large_bits": special["LARGE"],
        "flags": " ".join(FLAGS),
        "targets": list(TARGETS.values()),
        "scale": constant(2.0**-12 * script[0].scale * 2.0**23, law.precision),
    }


def _call(row: Row, precision: str) -> dict[str, Any]:
    return {
        "op": row.op,
        "count": row.count,
        "scale": constant(row.scale, precision),
        "digest": f"0x{row.digest:08X}U",
    }
