"""Filter files of LIGO's foton: modules of second-order sections between an input and an output matrix."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, one_of
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.deploy.exchange.foton_sections import FotonSections, cascade, modal_sum
from ultraquiet.deploy.law.biquad import BankChannel, channels
from ultraquiet.values.state_space import StateSpace

ARRANGEMENTS = {"cascade": cascade, "sum": modal_sum}
MODULE_SECTIONS, MODULE_FILTERS = 10, 10  # sections a filter and filters a module, as the front ends read them
NAME_LENGTH = 39  # of a module, likewise
SWITCHING = 21  # histories cleared when a filter is switched on, its output switched at once
TOLERANCE = 1e-6  # of the response: a thousandth of what float32 code may cost the loop
HEADER = "# FILTERS FOR ONLINE SYSTEM"
RULE = "#" * 80


@dataclass(frozen=True, eq=False)
class Module:
    """One module: `u += sink * k(source' y)`, its sections as one chain."""

    name: str
    sections: FotonSections
    source: FloatArray
    sink: FloatArray


@dataclass(frozen=True, eq=False)
class FotonFile:
    """What a filter file says: the modules' outputs add up to u = K y."""

    rate_hz: float
    modules: tuple[Module, ...]

    def frequency_response(self, f_hz: ArrayLike) -> ComplexArray:
        """Return the response `(nu, ny, nf)` at frequencies in Hz, from the sections themselves."""
        f = np.asarray(f_hz, dtype=np.float64)
        responses = [
            np.einsum("i,j,f->ijf", m.sink, m.source, m.sections.frequency_response(f, self.rate_hz))
            for m in self.modules
        ]
        return np.sum(responses, axis=0)

    def state_space(self) -> StateSpace:
        """Return the law, with two states for each section."""
        from scipy.linalg import block_diag

        parts = [m.sections.state_space(self.rate_hz) for m in self.modules]
        T, S = np.stack([m.source for m in self.modules]), np.stack([m.sink for m in self.modules], axis=1)
        A, B, C = (np.asarray(block_diag(*[getattr(p, name) for p in parts])) for name in "ABC")
        D = np.diag([float(p.D[0, 0]) for p in parts])
        return StateSpace(A, B @ T, S @ C, S @ D @ T, rate_hz=self.rate_hz)


def foton_text(
    law: StateSpace,
    name: str = "CONTROLLER",
    *,
    arrangement: str = "cascade",
    coupled: bool = False,
    tolerance: float = TOLERANCE,
) -> str:
    """Return a law as the text of a foton filter file.

    u = sum_c s_c k_c(t_c' y), k_c = g prod (1 + b1 z^-1 + b2 z^-2) / (1 + a1 z^-1 + a2 z^-2).

    Each module has one input and one output, so the law must fall into scalar channels: one strut's measurement to the
    same strut's command, or combinations of them, which the input matrix (rows t) and output matrix (columns s) in the
    file's comments hold. Sections have no pure delay; a delay is a zero at -2^44, to 6e-14 of the response. The text is
    read back and compared before it is returned: a1 and a2 of a mode at f with damping zeta hold its peak to about
    1e-16 / (2 zeta (2 pi f / rate)^2) only, and a chain's zeros lose more, which is why `sum` is the exacter one.
    Limits, ramps and anti-windup are not part of it.

    Args:
        law: discrete controller, u = K y.
        name: prefix of the modules' names.
        arrangement: `cascade`, one module a channel, or `sum`, one a mode, to be added.
        coupled: write a law that couples its channels as the matrix of its pairs, each a filter with all its states.
        tolerance: largest relative error of the response that is let through.

    Raises:
        InputError: a coupled law without `coupled`, more sections than a module holds, a response that the format
            cannot hold, a bad name, continuous time.

    >>> law = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.5]], rate_hz=3500.0)
    >>> print(foton_text(law).splitlines()[-1])
    CONTROLLER_U1_Y1 0 21 1 0 0 FM1 0.5 -0.9 0 -0.7 0

    Reference: the front ends' reader of these files, `fmReadCoeff` of LIGO's real-time code generator: name, filter,
    switching, sections, ramp, timeout, label, gain, then a1 a2 b1 b2 a section, up to ten sections a filter and ten
    filters a module; T080135 (CDS real-time code generator, application developer's guide).
    """
    if law.rate_hz is None:
        raise InputError("foton: the controller is in continuous time; discretise it at the bench's rate first.")
    one_of("foton", "arrangement", arrangement, tuple(ARRANGEMENTS))
    between("foton", "tolerance", tolerance, 0.0, 1.0)
    prefix = name.upper()
    if not prefix.isascii() or not prefix.replace("_", "a").isalnum():
        raise InputError(f"foton: 'name' must be letters, digits and _, got {name!r}.")
    modules: list[Module] = []
    for k, channel in enumerate(_channels(law, coupled)):
        parts = ARRANGEMENTS[arrangement](channel.law)
        label = f"{prefix}_{_label(channel, k)}"
        several = len(parts) > 1
        modules += [
            Module(f"{label}_M{i + 1}" if several else label, one, channel.source, channel.sink)
            for i, one in enumerate(parts)
        ]
    text = _text(float(law.rate_hz), modules)
    _require_same(law, read_foton(text), arrangement, tolerance)
    return text


def response_error(law: StateSpace, other: FotonFile) -> float:
    """Return the largest relative difference of two responses, at 400 frequencies and at every pole."""
    rate_hz = float(law.rate_hz or 0)
    at_poles = np.abs(np.angle(law.poles())) * rate_hz / (2 * np.pi) if law.states else np.zeros(0)
    f_hz = np.concatenate([np.geomspace(1e-4, 0.5, 400) * rate_hz, at_poles])
    expected, actual = law.frequency_response(f_hz), other.frequency_response(f_hz)
    size = np.linalg.norm(expected, axis=(0, 1))
    floor = max(float(size.max()), np.finfo(float).tiny) * np.finfo(float).eps
    return float(np.max(np.linalg.norm(actual - expected, axis=(0, 1)) / np.maximum(size, floor)))


def read_foton(text: str) -> FotonFile:
    """Return what a filter file says; modules without matrices in comments stand on the diagonal.

    Raises:
        StorageError: no sampling rate, or lines that are no filters.
    """
    rate_hz, turns = 0.0, dict[tuple[str, str], FloatArray]()
    rows = dict[str, list[list[float]]]()
    gains = dict[str, float]()
    current, left = "", 0
    for line in text.splitlines():
        words = line.split()
        try:
            if line.startswith("#"):
                if words[1:3] == ["SAMPLING", "RATE"]:
                    rate_hz = float(words[3])
                elif words[1:2] in (["INPUT"], ["OUTPUT"]):
                    turns[words[1], words[2]] = np.array([float(w) for w in words[3:]])
            elif len(words) == 12 and not left:
                current, left = words[0], int(words[3]) - 1
                gains[current] = gains.get(current, 1.0) * float(words[7])
                rows.setdefault(current, []).append([float(w) for w in words[8:]])
            elif len(words) == 4 and left:
                rows[current].append([float(w) for w in words])
                left -= 1
            elif words:
                raise ValueError(f"{len(words)} words")
        except (ValueError, IndexError) as error:
            raise StorageError(f"foton: the line '{line[:60]}' is no filter ({error}).") from None
    if rate_hz <= 0 or not rows or left:
        raise StorageError("foton: a filter file needs '# SAMPLING RATE', filters, and all sections they announce.")
    units = np.eye(len(rows))
    modules = [
        Module(
            name,
            FotonSections(gains[name], np.array(numbers)),
            turns[("INPUT", name)] if ("INPUT", name) in turns else units[k],
            turns[("OUTPUT", name)] if ("OUTPUT", name) in turns else units[k],
        )
        for k, (name, numbers) in enumerate(rows.items())
    ]
    return FotonFile(rate_hz, tuple(modules))


def _channels(law: StateSpace, coupled: bool) -> list[BankChannel]:
    if not coupled:
        try:
            return channels(law)
        except InputError as refusal:
            ny, nu = law.D.shape[1], law.D.shape[0]
            why = str(refusal).split(";", maxsplit=1)[0].removeprefix("deploy: ")
            raise InputError(
                f"foton: this law couples its channels, and a module has one input and one output: it would take"
                f" {nu * ny} filters of {law.states} states each, one for every pair of measurement and command; write"
                f" MAT, HDF5 or CSV, or ask for them with coupled=True ({why})."
            ) from None
    return [
        BankChannel(
            StateSpace(law.A, law.B[:, [j]], law.C[[i]], law.D[[i]][:, [j]], rate_hz=law.rate_hz),
            np.eye(law.D.shape[1])[j],
            np.eye(law.D.shape[0])[i],
        )
        for i in range(law.D.shape[0])
        for j in range(law.D.shape[1])
    ]


def _label(channel: BankChannel, k: int) -> str:
    one, other = np.flatnonzero(channel.sink), np.flatnonzero(channel.source)
    return f"U{one[0] + 1}_Y{other[0] + 1}" if one.size == 1 and other.size == 1 else f"C{k + 1}"


def _text(rate_hz: float, modules: list[Module]) -> str:
    lines = [HEADER, "#", "# Computer generated file: DO NOT EDIT", f"# SAMPLING RATE {_number(rate_hz)}", "#"]
    names = [m.name for m in modules]
    lines += [f"# MODULES {' '.join(names[k : k + 4])}" for k in range(0, len(names), 4)]
    for m in modules:
        if len(m.name) > NAME_LENGTH:
            raise InputError(f"foton: a module's name has at most {NAME_LENGTH} letters, got '{m.name}'.")
        lines += [RULE, f"### {m.name}", RULE, f"# SAMPLING {m.name} {_number(rate_hz)}"]
        lines += [f"# INPUT {m.name} {_numbers(m.source)}", f"# OUTPUT {m.name} {_numbers(m.sink)}", "###"]
        lines += _filters(m)
    return "\n".join(lines) + "\n"


def _filters(module: Module) -> list[str]:
    rows, lines = module.sections.rows, list[str]()
    parts = [rows[k : k + MODULE_SECTIONS] for k in range(0, len(rows), MODULE_SECTIONS)]
    if len(parts) > MODULE_FILTERS:
        raise InputError(
            f"foton: a module holds {MODULE_FILTERS * MODULE_SECTIONS} sections, '{module.name}' needs {len(rows)};"
            " reduce the law, or take arrangement='sum'."
        )
    for k, part in enumerate(parts):
        gain = module.sections.gain if k == 0 else 1.0
        head = f"{module.name} {k} {SWITCHING} {len(part)} 0 0 FM{k + 1} {_number(gain)}"
        lines.append(f"{head} {_numbers(part[0])}")
        lines += [f"{' ' * len(head)} {_numbers(row)}" for row in part[1:]]
    return lines


def _require_same(law: StateSpace, back: FotonFile, arrangement: str, tolerance: float) -> None:
    error = response_error(law, back)
    if not error <= tolerance:
        more = "" if arrangement == "sum" else "take arrangement='sum', "
        raise InputError(
            f"foton: as second-order sections in float64 this law's response changes by {error:.1e} of its size, beyond"
            f" tolerance={tolerance:g}; {more}a lower rate, or MAT, HDF5 or CSV."
        )


def _number(value: float) -> str:
    number = float(value) + 0.0  # no -0
    return str(int(number)) if number == int(number) and abs(number) < 1e6 else repr(number)


def _numbers(values: FloatArray) -> str:
    return " ".join(_number(v) for v in values)
