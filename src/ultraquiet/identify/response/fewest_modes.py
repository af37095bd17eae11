"""As few modes of rank one as meet a response like residues of full rank do."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg import vector_fitting
from ultraquiet.linalg.modes import rank_elimination, rank_one

ROUGH_STEPS, FINE_STEPS = 8, 20  # of the search for directions and poles: to compare sets of modes, and at the end
REACH = 8.0  # error in units of the goal, from which the search for poles and directions may still lead back
AMPLE = 0.03  # error in units of the goal, below which nothing is sought any more
TOGETHER = 0.1  # share of the modes that is tried to leave at once
UNTOLD = 0.02  # radians by which damping moves the phase at the nearest line, below which no line tells it
# A line may be met worse than by residues of full rank by so many times what precision is not worth a state or, where
# that is more, by so many times its noise: whoever follows that needs more states, and is no nearer to the truth.
LINE, NOISE = 10.0, 2.0
ABOUT = 4  # lines to either side that tell of the noise of one
FAILURES = 2  # modes tried in turn, the faintest first, before nothing more is taken off


class Trial(NamedTuple):
    """Modes, their weighted RMS error at the lines held out, and how much worse one of these is met.

    `worst` is the largest rise of a line's error above that of residues of full rank, in units of what is allowed.
    """

    modes: rank_one.RankOneModes
    held_out: float
    worst: float


class Thinning(NamedTuple):
    """Lines to fit, lines to judge by, the error there that must be met, and what precision is not worth a state.

    `known` `(nf,)` is what residues of full rank miss of each line to judge by, and `noise` what hides a miss there. A
    few lines about a mode that one direction alone hears weigh next to nothing among all of them: no line may be met
    much worse.
    """

    fitted: rank_one.Samples
    held_out: rank_one.Samples
    goal: float
    spare: float
    known: FloatArray
    noise: FloatArray

    def met_by(self, trial: Trial) -> bool:
        """Return whether the goal is met, and every line."""
        return trial.held_out <= self.goal and trial.worst <= 1.0

    def judged(self, modes: rank_one.RankOneModes) -> Trial:
        """Return the modes as they are, with what they miss of the lines held out."""
        errors = self.held_out.errors(modes)
        allowed = np.maximum(LINE * self.spare, NOISE * self.noise)
        return Trial(modes, self.held_out.rms(errors), rise(errors / allowed, self.known / allowed))

    def tried(self, modes: rank_one.RankOneModes, steps: int) -> Trial:
        """Return the modes refined.

        A mode that the search left so sharp between two lines that neither tells its damping follows their noise: it
        leaves where those held out are met better without it.
        """
        best = self._refined(modes, steps)
        while best.held_out > self.goal and len(best.modes.heads()) > 1:
            untold = _untold(best.modes, self.fitted)
            if not untold.size:
                break
            others = best.modes.only(np.setdiff1d(best.modes.heads(), untold[:1]))
            fewer = self._refined(rank_one.fitted_outputs(others, self.fitted), steps)
            if fewer.held_out >= best.held_out:
                break
            best = fewer
        return best

    def _refined(self, modes: rank_one.RankOneModes, steps: int) -> Trial:
        return self.judged(rank_one.refined(modes, self.fitted, steps, AMPLE * self.goal))

    def tightened(self, best: float) -> "Thinning":
        """Return the task with a goal that also keeps what a set of modes was seen to reach."""
        return self._replace(goal=min(self.goal, float(np.hypot(best, self.spare))))

    def eased(self) -> "Thinning":
        """Return the task with a goal that gives up the precision that is not worth a state."""
        return self._replace(goal=float(np.hypot(self.goal, self.spare)))


def about(errors: FloatArray) -> FloatArray:
    """Return the median of each line's error and those of `ABOUT` lines to either side: not what one line misses.

    >>> about(np.array([1.0, 2.0, 9.0, 2.0, 1.0, 2.0]))
    array([2., 2., 2., 2., 2., 2.])
    """
    lines = range(errors.size)
    return np.array([np.median(errors[max(k - ABOUT, 0) : k + ABOUT + 1]) for k in lines], dtype=np.float64)


def rise(errors: FloatArray, known: FloatArray) -> float:
    """Return how much worse a line is met: the root of the largest rise of a squared error, 0 where none rises.

    >>> rise(np.array([0.3, 0.5]), np.array([0.3, 0.4])).__round__(3)
    0.3
    """
    return float(np.sqrt(np.max(errors**2 - known**2, initial=0.0)))


def fewest(fits: Iterable[vector_fitting.PoleResidueFit], task: Thinning) -> Trial | None:
    """Return modes that meet the goal with as few states as found, or None.

    Every direction of every residue begins as a mode. The faintest leave, poles held, until what is left misses the
    goal by far. Of several fits the one goes on that meets the goal with fewest states by then: from its smallest set
    upwards all poles and directions are sought together, until one meets the goal, or else nearly does. Where not a
    single mode can leave they follow noise too, and leave for what precision is not worth a state.
    """
    _, sets = min((_eliminated(fit, task) for fit in fits), key=lambda found: found[0])
    missed: list[Trial] = []
    while sets:
        trial = task.tried(sets.pop(), ROUGH_STEPS)
        if not task.met_by(trial):
            missed.append(trial)
            continue
        larger = task.tried(sets.pop(), ROUGH_STEPS) if sets else trial
        task = task.tightened(min(trial.held_out, larger.held_out))
        chosen = larger if task.met_by(larger) and not task.met_by(trial) else trial
        found = _thinned(chosen, task)
        return _thinned(chosen, task.eased()) if found is chosen else found
    return _nearly(missed, task)


def _nearly(missed: list[Trial], task: Thinning) -> Trial | None:
    """Return the smallest of rising sets of modes that misses the goal by what precision is not worth a state."""
    eased = task.eased()
    found = next((trial for trial in missed if eased.met_by(trial)), None)
    return None if found is None else _thinned(found, eased)


def settled(modes: rank_one.RankOneModes, samples: rank_one.Samples, spare: float) -> rank_one.RankOneModes:
    """Return the modes fitted once more, to all lines: those that chose them tell of their poles too.

    A search that ends on the circle has left a mode so sharp that no line tells its damping: it stands between two
    lines for what neither asks for, and a loop that is closed on it may be unstable by it. Such a mode leaves, and the
    others are fitted without it, where the lines are met as well to what precision is not worth a state.
    """
    found = rank_one.refined(modes, samples, FINE_STEPS)
    wanted: list[complex] = []
    while True:
        untold = [k for k in _untold(found, samples) if complex(found.poles[k]) not in wanted]
        if not untold or len(found.heads()) == 1:
            return found
        others = found.only(np.setdiff1d(found.heads(), untold[:1]))
        fewer = rank_one.refined(others, samples, FINE_STEPS)
        if samples.error(fewer) <= np.hypot(samples.error(found), spare):
            found = fewer
        else:
            wanted.append(complex(found.poles[untold[0]]))


def _untold(modes: rank_one.RankOneModes, samples: rank_one.Samples) -> np.ndarray:
    """Return the modes whose half-width is next to nothing beside how far the nearest line is, the sharpest first.

    With a line at distance d a half-width s moves the phase of 1 / (z - p) there by s / d.
    """
    heads = modes.heads()
    decay: ComplexArray = -np.log(modes.poles[heads])
    distance = np.abs(np.angle(samples.z)[:, None] + decay.imag).min(axis=0)
    share = decay.real / np.maximum(distance, np.finfo(float).tiny)
    order = np.argsort(share, kind="stable")
    return heads[order[share[order] < UNTOLD]]


def _eliminated(fit: vector_fitting.PoleResidueFit, task: Thinning) -> tuple[int, list[rank_one.RankOneModes]]:
    """Return with how many states the goal is met while the poles are held, and the sets of modes, falling in size."""
    modes = rank_elimination.all_directions(fit.poles, fit.residues)
    sets, least = [modes], modes.poles.size
    for fewer in rank_elimination.eliminated(modes, task.fitted):
        trial = task.judged(fewer)
        if trial.held_out > REACH * task.goal:
            break
        sets.append(fewer)
        if task.met_by(trial):
            least = fewer.poles.size
    return least, sets


def _thinned(trial: Trial, task: Thinning) -> Trial:
    """Take off the faintest modes, several at once and fewer where that is too many, as long as the goal is met."""
    together, failed = max(1, round(TOGETHER * len(trial.modes.heads()))), 0
    while failed < FAILURES and len(trial.modes.heads()) > failed + together:
        heads = trial.modes.heads()
        faint = rank_elimination.faintest(trial.modes, task.fitted)[failed : failed + together]
        # what those that leave did falls to the others' outputs first: poles that had to make up for it went astray
        others = rank_one.fitted_outputs(trial.modes.only(np.delete(heads, faint)), task.fitted)
        tried = task.tried(others, ROUGH_STEPS)
        if task.met_by(tried):
            trial, failed = tried, 0
        elif together > 1:
            together //= 2
        else:
            failed += 1
    return trial
