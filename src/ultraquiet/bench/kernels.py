"""The sampled loop, compiled. Import where it is used: numba costs half a second."""

import numpy as np

from ultraquiet._base.compiled import compiled
from ultraquiet.bench.machine_code import call_step

FAINTEST = 1e-200


@compiled
def add_product(A, x, out):
    """Add A x to out; A as `columns.spanned` lays it out, so that the inner loop runs along memory and past zeros."""
    columns, first, end = A
    for j in range(x.size):
        value, column = x[j], columns[j]
        for i in range(first[j], end[j]):
            out[i] += column[i] * value


@compiled
def take(values, into):
    """Copy values; what is too faint to matter becomes zero, because processors are slow with still fainter numbers."""
    for i in range(values.size):
        value = values[i]
        into[i] = value if abs(value) >= FAINTEST else 0.0 * value


@compiled
def read(C, x, noise, limits, step, y):
    """Fill y with the readings C x + noise, clipped to +-limits and rounded to multiples of step (0: not rounded)."""
    for i in range(y.size):
        y[i] = noise[i]
    add_product(C, x, y)
    for i in range(y.size):
        value = min(max(y[i], -limits[i]), limits[i])
        y[i] = step * np.rint(value / step) if step > 0.0 else value


@compiled
def clip(values, limits, into, counts):
    """Put values limited to +-limits into `into`, counting those limited."""
    for i in range(values.size):
        if values[i] > limits[i] or values[i] < -limits[i]:
            counts[i] += 1
        into[i] = min(max(values[i], -limits[i]), limits[i])


@compiled
def slip(thresholds, weights, anchors, values):
    """Send the leading values through plays: each anchor is dragged along once its value is a threshold away.

    Values beyond the rows of `anchors` belong to actuators without hysteresis and pass unchanged.
    """
    if weights.size == 0:
        return
    for i in range(anchors.shape[0]):
        total = 0.0
        for j in range(weights.size):
            anchors[i, j] = min(max(anchors[i, j], values[i] - thresholds[j]), values[i] + thresholds[j])
            total += weights[j] * anchors[i, j]
        values[i] = total


@compiled
def move(plant, state, disturbance, limits, driven, work, counts):
    """Advance the plant one sample under the held command plus the disturbance, limited to +-limits."""
    A, B, _, thresholds, weights = plant
    x, held, anchors = state
    for i in range(held.size):
        driven[i] = held[i] + disturbance[i]
    clip(driven, limits, driven, counts)
    slip(thresholds, weights, anchors, driven)
    for i in range(work.size):
        work[i] = 0.0
    add_product(A, x, work)
    add_product(B, driven, work)
    take(work, x)


@compiled
def send(plant, asked, sent, limits, state, spaces, results):
    """Apply what was held and hold what is asked for, both `(nu,)` before they fade by `gain`; see `loop`.

    sent = (disturbance, gain), spaces = (driven, pushed, work) to compute in, results = (command, counts).
    """
    disturbance, gain = sent
    driven, pushed, work = spaces
    command, limited = results
    held = state[1]
    for i in range(asked.size):
        asked[i] *= gain
        pushed[i] = gain * disturbance[i]
    move(plant, state, pushed, limits[1], driven, work, limited[1])
    clip(asked, limits[0], held, limited[0])
    for i in range(asked.size):
        command[i] = held[i] + 0.0 * asked[i]  # no number where none was asked for


@compiled
def loop(plant, law, signals, limits, state, xk, results):
    """Run on from `state` and the law's state `xk`, both left where the samples end.

    Signals and results are `(samples, channels)`, matrices as `columns.spanned` lays them out. plant = (A, B, C,
    thresholds and weights of the plays), law = (A, B, C, D), signals = (actuation, disturbance, noise, gain of whatever
    is sent), limits = (commands, actuators, readings, step of the converter), state = (x, held commands, anchors of
    the plays), results = (commands, readings, counts of limited commands and actuators), all of them filled here.
    """
    KA, KB, KC, KD = law
    actuation, disturbance, noise, gain = signals
    command, outputs, limited = results
    nu = actuation.shape[1]
    x, workk, asked = state[0], np.empty(xk.size), np.empty(nu)
    spaces = np.empty(nu), np.empty(nu), np.empty(x.size)
    for k in range(actuation.shape[0]):
        read(plant[2], x, noise[k], limits[2], limits[3], outputs[k])
        for i in range(nu):
            asked[i] = actuation[k, i]
        add_product(KC, xk, asked)
        add_product(KD, outputs[k], asked)
        for i in range(xk.size):
            workk[i] = 0.0
        add_product(KA, xk, workk)
        add_product(KB, outputs[k], workk)
        take(workk, xk)
        send(plant, asked, (disturbance[k], gain[k]), limits, state, spaces, (command[k], limited))


@compiled
def loop_of_code(plant, law, signals, limits, state, results):
    """Run on from `state` under a law of machine code, which keeps its own; else as `loop`.

    law = (addresses of its step, of its state, of what it reads and gives, the arrays `(ny,)` and `(nu,)` at the last
    two in the code's precision, and the places of these channels among the bench's).
    """
    step, law_state, at_readings, at_commands, readings, commands, reads, drives = law
    actuation, disturbance, noise, gain = signals
    command, outputs, limited = results
    nu = actuation.shape[1]
    x, asked = state[0], np.empty(nu)
    spaces = np.empty(nu), np.empty(nu), np.empty(x.size)
    for k in range(actuation.shape[0]):
        read(plant[2], x, noise[k], limits[2], limits[3], outputs[k])
        for i in range(readings.size):
            readings[i] = outputs[k, reads[i]]
        call_step(step, law_state, at_readings, at_commands)
        for i in range(nu):
            asked[i] = actuation[k, i]
        for i in range(commands.size):
            asked[drives[i]] += commands[i]
        send(plant, asked, (disturbance[k], gain[k]), limits, state, spaces, (command[k], limited))
