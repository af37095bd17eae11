"""Coefficients for code that runs: another law in the form, size and precision of the first."""

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.deploy.law.anti_windup import conditioning_gain
from ultraquiet.deploy.law.coefficients import CoefficientBank, fitting_bank
from ultraquiet.deploy.law.law import Law, require_discrete, rounded
from ultraquiet.deploy.law.realisation import Realisation, realisation
from ultraquiet.values.state_space import StateSpace


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
