"""The law's coefficients as one run of numbers: the bank that the code holds and that may be replaced as it runs."""

import zlib
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray, frozen
from ultraquiet._base.errors import InputError
from ultraquiet.deploy.law import biquad
from ultraquiet.deploy.law.anti_windup import conditioning_gain
from ultraquiet.deploy.law.law import Law, Rounded, require_discrete
from ultraquiet.deploy.law.realisation import Realisation, realisation
from ultraquiet.deploy.law.rounding import rounded
from ultraquiet.values.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class CoefficientSection:
    """A run of rows with one meaning; rows differ in length where blocks do."""

    label: str
    says: str
    rows: list[Rounded]


@dataclass(frozen=True, eq=False)
class CoefficientBank:
    """What `NAME_load_bank` takes: 32-bit words, a number of 64 bits as two, low one first, and their CRC-32."""

    words: NDArray[np.uint32]
    crc: int


def sections(law: Law) -> list[CoefficientSection]:
    """Return the coefficients in the order of the code: those of `evaluate`, then a row of A, B, L for each state."""
    own = [row for block in law.blocks for row in block]
    more = law.B if law.L is None else np.concatenate([law.B, law.L], axis=1)
    listed = [
        CoefficientSection("D", "a row for each measurement", list(law.D.T)),
        CoefficientSection("C", "a row for each state", list(law.C.T)),
    ]
    if law.channels:
        B, C, D = biquad.sections(law)
        listed = [
            CoefficientSection("D", "a number for each channel", [D]),
            CoefficientSection("C", "a row for each block", list(C.reshape(-1, 2))),
        ]
        if law.turn_in is not None and law.turn_out is not None:
            listed.append(CoefficientSection("TURN_IN", "a row for each channel, from measurements", list(law.turn_in)))
            listed.append(CoefficientSection("TURN_OUT", "a row for each command, from channels", list(law.turn_out)))
        more = B[:, None] if law.L is None else np.concatenate([B[:, None], _own_gain(law, law.L)], axis=1)
    drive = [np.concatenate([row, rest]) for row, rest in zip(own, more, strict=True)]
    parts = f"its row of A{' - I' if law.delta else ''} within the block, of B{'' if law.L is None else ', of L'}"
    return [*listed, CoefficientSection("DRIVE", f"for each state {parts}", drive)]


def numbers(law: Law) -> Rounded:
    """Return all coefficients of the bank in one row, in the code's precision."""
    return np.concatenate([row for section in sections(law) for row in section.rows])


def bank_of(law: Law) -> CoefficientBank:
    """Return a law's bank as words and CRC-32 (IEEE 802.3, over the words' bytes, lowest first).

    Reference: IEEE 802.3, section 3.2.9.
    """
    return bank_from(numbers(law))


def bank_from(row: Rounded) -> CoefficientBank:
    """Return numbers in the code's precision as words and CRC-32."""
    raw = row.astype(row.dtype.newbyteorder("<")).tobytes()
    return CoefficientBank(frozen(np.frombuffer(raw, "<u4").astype(np.uint32)), zlib.crc32(raw))


def fitting_bank(running: Law, law: Law) -> CoefficientBank:
    """Return the bank of `law` for code generated from `running`.

    Raises:
        InputError: another form, size of blocks, precision or number of channels; or one has anti-windup, one has not.
    """
    if _shape(running) != _shape(law):
        raise InputError(
            f"deploy: code for {_said(running)} cannot take the coefficients of {_said(law)}; generate it again."
        )
    return bank_of(law)


def with_numbers(law: Law, row: Rounded) -> Law:
    """Return the law whose bank is `row`; a bank of channels takes its numbers into the same places."""
    at, rows_of = 0, {}
    for section in sections(law):
        rows = []
        for old in section.rows:
            rows.append(row[at : at + old.size])
            at += old.size
        rows_of[section.label] = rows
    widths = [len(block) for block in law.blocks for _ in block]
    A = [part[:n] for part, n in zip(rows_of["DRIVE"], widths, strict=True)]
    rest = np.stack([part[n:] for part, n in zip(rows_of["DRIVE"], widths, strict=True)])
    starts = np.cumsum([0, *(len(b) for b in law.blocks)])
    blocks = tuple(np.stack(A[i:j]) for i, j in pairwise(starts))
    if not law.channels:
        B, L = rest[:, : law.inputs], rest[:, law.inputs :]
        C, D = np.stack(rows_of["C"]).T, np.stack(rows_of["D"]).T
        return replace(law, blocks=blocks, B=B, C=C, D=D, L=None if law.L is None else L)
    of = np.repeat(np.arange(len(law.channels)), 2 * np.array(law.channels))
    states = np.arange(law.states)
    B, C, L = np.zeros_like(law.B), np.zeros_like(law.C), None
    B[states, of], C[of, states] = rest[:, 0], np.concatenate(rows_of["C"])
    if law.L is not None:
        L = rest[:, 1:]
        if not law.turned:
            L = np.zeros_like(law.L)
            L[states, of] = rest[:, 1]
    turns = [np.stack(rows_of[k]) if k in rows_of else None for k in ("TURN_IN", "TURN_OUT")]
    D = np.diag(rows_of["D"][0])
    return replace(law, blocks=blocks, B=B, C=C, D=D, L=L, turn_in=turns[0], turn_out=turns[1])


def law_like(running: Law, controller: StateSpace) -> Law:
    """Return a controller as a law in the form and precision of another, with its limits, ramp and anti-windup.

    Raises:
        InputError: another sampling rate, or no such form for this controller.
    """
    require_discrete(controller, running.name)
    if controller.rate_hz != running.rate_hz:
        raise InputError(f"deploy: the code runs at {running.rate_hz:g} Hz, the controller at {controller.rate_hz} Hz.")
    parts = realisation(controller, running.form)
    return rounded(
        parts,
        None if running.L is None else anti_windup_gain(parts),
        running.limits,
        running.precision,
        rate_hz=running.rate_hz,
        order=controller.states,
        name=running.name,
        ramp_steps=running.ramp_steps,
        excitation=running.excitation,
        overrun_limit=running.overrun_limit,
    )


def bank_for(running: Law, controller: StateSpace) -> CoefficientBank:
    """Return a controller's coefficients for `NAME_load_bank` of code generated from another law.

    Coordinates are those of this controller's own modes: swap by a ramp unless only gains differ.

    Raises:
        InputError: another rate, number of channels or states.
    """
    return fitting_bank(running, law_like(running, controller))


def anti_windup_gain(parts: Realisation) -> FloatArray:
    """Return the anti-windup gain; that of a plain bank leaves every command to its channel."""
    whole_law = parts.state_space(None)
    L = conditioning_gain(whole_law.A, whole_law.B, whole_law.C, whole_law.D)
    return L * (parts.C.T != 0) if parts.channels and parts.turn_in is None else L


def _own_gain(law: Law, L: Rounded) -> Rounded:
    """Return the anti-windup gain as stored: one number a state in a plain bank, whose others are zero."""
    return L if law.turned else L.sum(axis=1, keepdims=True)


def _shape(law: Law) -> tuple[Any, ...]:
    sizes = [len(b) for b in law.blocks]
    return law.precision, law.form, law.D.shape, law.channels, law.turned, law.L is None, sizes, law.rate_hz


def _said(law: Law) -> str:
    more = "" if law.L is None else " with anti-windup"
    return f"{law.states} states, {law.inputs} x {law.outputs}, {law.form}, {law.precision}{more} at {law.rate_hz:g} Hz"
