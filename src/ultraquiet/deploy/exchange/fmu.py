"""The controller as a functional mock-up unit: the generated C, unchanged, behind the interface of FMI 2.0 or 3.0."""

import io
import os
import platform
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.constraints import one_of
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.provenance import versions
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c_code import render
from ultraquiet.deploy.c_code.plan import GeneratedCode
from ultraquiet.deploy.exchange.fmu_refused import REFUSED
from ultraquiet.deploy.law.law import DTYPES, Law
from ultraquiet.deploy.toolchain import compiler
from ultraquiet.files import write_bytes
from ultraquiet.values.channel import Channel, channels
from ultraquiet.values.status import Status, StatusWord

VERSIONS = ("2.0", "3.0")
EPOCH = (1980, 1, 1, 0, 0, 0)  # the oldest date a zip file knows: the same law makes the same bytes
COUNTERS = {
    "mode": "0 off, 1 on, 2 ramping out, 3 fault",
    "faults": "bits: 1 a measurement was not finite, 2 the law left the range of its numbers",
    "clipped": "steps in which a limit was met",
}
TIME = "time"
RAMP = "ramp"
_RAMP_SAYS = "start with the ramp of a real start instead of full command"
_MACHINES = {"AMD64": "x86_64", "arm64": "aarch64"}


@dataclass(frozen=True)
class FmuFile(Shown):
    """A unit that was written: `platform` names the folder of its compiled binary, None for sources alone."""

    path: Path
    version: str
    platform: str | None
    status: Status


def write_fmu(
    made: GeneratedCode,
    path: str | os.PathLike[str],
    version: str = "3.0",
    *,
    inputs: Sequence[Channel | str] | None = None,
    outputs: Sequence[Channel | str] | None = None,
    binary: bool = True,
) -> FmuFile:
    """Write a deployed law as a functional mock-up unit (FMU) for co-simulation, sources and binary in one file.

    u[k] = K y[k]: set the measurements, step by one sample period, get the commands.

    The generated files stand in the unit's `sources` as they are. A communication step of several periods runs the law
    as often with its measurements held; one that is no whole number of periods, or does not begin where the last one
    ended, is an error with a sentence in the importer's log. The parameter `ramp` asks for the ramp of a real start;
    the outputs `mode`, `faults` and `clipped` tell of the guards. Each instance has a state of its own, which an
    importer can keep and give back; it cannot be serialised.

    Args:
        made: what `generate` returned; its folder must still be there.
        path: the file, ending in `.fmu`.
        version: `3.0` or `2.0` of the standard.
        inputs: `(ny,)` measurements, names or channels with unit; `y1`, `y2`, ... in V when absent.
        outputs: `(nu,)` commands, likewise; `u1`, ... in V. Their limits are the law's.
        binary: add the unit compiled for this machine when there is a compiler.

    Returns:
        Path, version, platform of the binary, and a status with a sentence.

    Raises:
        InputError: names that clash, another version, numbers that are not floating-point.
        StorageError: the folder is gone or the file cannot be written.
        ToolError: the compiler refused the unit.

    >>> import tempfile
    >>> from ultraquiet.deploy import generate
    >>> from ultraquiet.values import StateSpace
    >>> law = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> folder = tempfile.mkdtemp()
    >>> unit = write_fmu(generate(law, folder + "/code"), folder + "/law.fmu", binary=False)
    >>> sorted(zipfile.ZipFile(unit.path).namelist())[:2]
    ['documentation/README.md', 'modelDescription.xml']

    Reference: FMI 2.0.4 (https://fmi-standard.org/), sections 2 and 4; FMI 3.0.1, sections 2 and 4.
    """
    law = made.law
    one_of("write_fmu", "version", version, VERSIONS)
    if getattr(law, "precision", "") not in DTYPES:
        raise InputError(f"write_fmu: an FMU needs a law in {' or '.join(DTYPES)}, not in whole numbers.")
    if Path(path).suffix != ".fmu":
        raise InputError(f"write_fmu: an FMU is a file that ends in '.fmu', got '{path}'.")
    wires = _wires(law, inputs, outputs)
    files = _generated(made.folder, law.name)
    context = _context(law, wires, version, list(files))
    files |= _interface(context, version)
    entries: dict[str, bytes] = {f"sources/{name}": text.encode() for name, text in files.items()}
    entries["modelDescription.xml"] = render.render(f"fmu_{version[0]}.xml.j2", context).encode()
    entries["documentation/README.md"] = (made.folder / "README.md").read_bytes()
    if version == "3.0":
        entries["sources/buildDescription.xml"] = render.render("fmu_build.xml.j2", context).encode()
    place, status = None, Status(StatusWord.SOURCES_ONLY, "The unit holds sources; the importer compiles them.")
    cc = compiler.compiler() if binary else None
    if cc is not None:
        place = binary_folder(version)
        entries[f"binaries/{place}/{law.name}{_extension()}"] = _compiled(cc, files, context["sources"])
        status = Status(StatusWord.OK, f"The unit holds sources and a binary for {place}, compiled by {cc}.")
    elif binary:
        status = Status(
            StatusWord.SOURCES_ONLY, "No C compiler was found (cc, gcc, clang or $CC): the unit holds sources alone."
        )
    return FmuFile(write_bytes(path, _zipped(entries)), version, place, status)


def binary_folder(version: str) -> str:
    """Return the name that a version of the standard gives to the binaries of this machine.

    >>> binary_folder("3.0").count("-")
    1
    """
    machine = _MACHINES.get(platform.machine(), platform.machine())
    system = {"linux": "linux", "darwin": "darwin", "win32": "windows"}.get(sys.platform, sys.platform)
    if version == "2.0" and machine == "x86_64":
        return {"linux": "linux64", "darwin": "darwin64", "windows": "win64"}.get(system, f"{machine}-{system}")
    return f"{machine}-{system}"


def _extension() -> str:
    return {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")


def _wires(
    law: Law, inputs: Sequence[Channel | str] | None, outputs: Sequence[Channel | str] | None
) -> tuple[tuple[Channel, ...], tuple[Channel, ...]]:
    y_names = [f"y{j + 1}" for j in range(law.inputs)] if inputs is None else inputs
    u_names = [f"u{i + 1}" for i in range(law.outputs)] if outputs is None else outputs
    y, u = channels("write_fmu", y_names, law.inputs, "input"), channels("write_fmu", u_names, law.outputs, "output")
    names = [TIME, RAMP, *COUNTERS]
    for wire in (*y, *u):
        if not wire.name.strip() or not wire.name.isprintable():
            raise InputError(f"write_fmu: {wire.name!r} cannot name a variable; use printable characters.")
        if wire.name in names:
            raise InputError(
                f"write_fmu: the name '{wire.name}' is taken twice; {TIME}, {RAMP}, {', '.join(COUNTERS)}"
                " belong to the unit itself."
            )
        names.append(wire.name)
    return y, u


def _generated(folder: Path, name: str) -> dict[str, str]:
    """Return the generated C files that a host program needs."""
    try:
        headers = sorted(folder.glob(f"{name}*.h"))
        return {f.name: f.read_text() for f in [folder / f"{name}.c", folder / f"{name}_host.c", *headers]}
    except OSError as error:
        raise StorageError(
            f"write_fmu: '{folder}' cannot be read ({error.strerror}); generate the code again."
        ) from None


def _interface(context: dict[str, Any], version: str) -> dict[str, str]:
    name = context["name"]
    return {
        f"{name}_fmu.h": render.render("fmu_core.h.j2", context),
        f"{name}_fmi{version[0]}.c": render.render(f"fmu_{version[0]}.c.j2", context),
    }


def _context(
    law: Law, wires: tuple[tuple[Channel, ...], tuple[Channel, ...]], version: str, generated: list[str]
) -> dict[str, Any]:
    y, u = wires
    names = [(c.name, c.unit) for c in (*y, *u)]
    reals = [_variable(c, 1 + j, "input", c.low, c.high) for j, c in enumerate(y)]
    limits = law.known_limits.tolist()
    first = 1 + law.inputs
    reals += [_variable(c, first + i, "output", *limits[i]) for i, c in enumerate(u)]
    after = first + law.outputs
    counters = [
        {"name": name, "reference": after + k, "description": says} for k, (name, says) in enumerate(COUNTERS.items())
    ]
    sources = [name for name in generated if name.endswith(".c")]
    return {
        "name": law.name,
        "NAME": law.name.upper(),
        "law": law,
        "token": "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, f"{law.hash} {version} {names}")) + "}",
        "description": f"u = K y, {law.order} states at {law.rate_hz:g} Hz, {law.precision}; coefficients {law.hash}",
        "rate": f"{law.rate_hz:g}",
        "rate_exact": float(law.rate_hz).hex(),
        "period": repr(1.0 / law.rate_hz),
        "version": versions()["ultraquiet"],
        "units": sorted({c.unit for c in (*y, *u) if c.unit}),
        "reals": reals,
        "counters": counters,
        "output_references": [first + k for k in range(law.outputs + len(COUNTERS))],
        "ramp_reference": after + len(COUNTERS),
        "ramp_description": _RAMP_SAYS,
        "time_name": TIME,
        "sources": [*sources, f"{law.name}_fmi{version[0]}.c"],
        "flags": " ".join(compiler.FLAGS),
        "refused": REFUSED[version],
    }


def _variable(wire: Channel, reference: int, causality: str, low: float, high: float) -> dict[str, Any]:
    from html import escape

    attributes = f' unit="{escape(wire.unit)}"' if wire.unit else ""
    for end, value in (("min", low), ("max", high)):
        attributes += f' {end}="{value!r}"' if np.isfinite(value) else ""
    return {"name": wire.name, "reference": reference, "causality": causality, "attributes": attributes}


def _compiled(cc: str, files: dict[str, str], sources: list[str]) -> bytes:
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        for name, text in files.items():
            (Path(work) / name).write_text(text)
        library = Path(work) / f"unit{_extension()}"
        hidden = "-fvisibility=hidden"
        compiler.compile_c([cc, *compiler.FLAGS, "-fPIC", "-shared", hidden, *sources, "-o", library], Path(work))
        return library.read_bytes()


def _zipped(entries: dict[str, bytes]) -> bytes:
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            archive.writestr(zipfile.ZipInfo(name, EPOCH), data, zipfile.ZIP_DEFLATED)
    return memory.getvalue()
