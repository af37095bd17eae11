"""The search that moves all poles to the least simulated error, modes that its end misses put in and sought with it."""

import numpy as np

from ultraquiet.identify.subspace import fit, missing_modes, modal_least_squares
from ultraquiet.identify.subspace.modal_least_squares import FilterBank, Modes
from ultraquiet.identify.subspace.settings import SubspaceSettings

RETURNS = 4  # to the search with modes that its end had missed


def sought(settings: SubspaceSettings, data: fit.Scaled) -> missing_modes.Sought:
    """Return the signals and what a fit to them may hold under these settings."""
    return missing_modes.Sought(data, bool(settings.feedthrough), settings.offset, settings.given_order is None)


def refined(settings: SubspaceSettings, data: fit.Scaled, modes: Modes) -> fit.SystemFit:
    """Return the system of least simulated error, modes that it misses put in and sought with the others."""
    within = sought(settings, data)
    found = fit.refined_simulation(fit.system(modes), data, settings.options())
    steps = found.steps
    bank, modes = within.fitted(found.system)
    for _ in range(RETURNS):
        other_bank, other = missing_modes.replenished(bank, modes, within)
        if np.array_equal(other.poles, modes.poles):
            detour = _by_a_detour(settings, within, modes)
            if detour is None:
                break
            (other_bank, other), more = detour
            steps += more
        trial = fit.refined_simulation(fit.system(other), data, settings.options())
        other_bank, other = within.fitted(trial.system)
        steps += trial.steps
        if not modal_least_squares.cost(other_bank, other) < modal_least_squares.cost(bank, modes):
            break
        found, bank, modes = trial, other_bank, other
    return fit.SystemFit(found.system, steps, found.converged)


def _by_a_detour(
    settings: SubspaceSettings, within: missing_modes.Sought, modes: Modes
) -> tuple[tuple[FilterBank, Modes], int] | None:
    """Return other modes for a search that ended with one missing though none is faint, and the steps to them.

    Two that share the place of one each carry much, and only beside the missing one does either become idle: it is
    put in, all are sought, and then the one that is missed least leaves. None where the error shows no mode.
    """
    wide = None if within.may_grow else missing_modes.widened(modes, within)
    if wide is None:
        return None
    found = fit.refined_simulation(fit.system(wide[1]), within.data, settings.options())
    return missing_modes.narrowed(*within.fitted(found.system)), found.steps
