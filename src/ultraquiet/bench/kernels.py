"""The sampled loop, compiled. Import where it is used: numba costs half a second.

What runs once a sample takes arrays, never tuples of them or rows of a larger one: to count who holds each of them took
as long as the arithmetic.
"""

import numpy as np

from ultraquiet._base.compiled import compiled
from ultraquiet.bench.machine_code import call_step

FAINTEST = 1e-200


@compiled
def add_product(columns, first, end, x, out):
    """Add A x to out; A as `columns.spanned` lays it out, so that the inner loop runs along memory and past zeros."""
    for j in range(x.size):
        value, column = x[j], columns[j]
        for i in range(first[j], end[j]):
            out[i] += column[i] * value


@compiled
def add_wide_product(columns, x, out):
    """Add A x to out for an A of few rows, given by its columns: four sums at a time stay out of memory."""
    rows, quads, inputs = np.uint64(out.size), np.uint64(out.size // 4 * 4), np.uint64(x.size)
    for i in range(np.uint64(0), quads, np.uint64(4)):
        first, second, third, fourth = out[i], out[i + 1], out[i + 2], out[i + 3]
        for j in range(inputs):
            value = x[j]
            first += columns[j, i] * value
            second += columns[j, i + 1] * value
            third += columns[j, i + 2] * value
            fourth += columns[j, i + 3] * value
        out[i], out[i + 1], out[i + 2], out[i + 3] = first, second, third, fourth
    for i in range(quads, rows):
        for j in range(inputs):
            out[i] += columns[j, i] * x[j]


@compiled
def take(values, into):
    """Copy values; what is too faint to matter becomes zero, because processors are slow with still fainter numbers."""
    for i in range(values.size):
        value = values[i]
        into[i] = value if abs(value) >= FAINTEST else 0.0 * value


@compiled
def read(columns, x, limits, step, y):
    """Add the readings C x to the noise in y; clip to +-limits, round to multiples of step (0: not rounded)."""
    add_wide_product(columns, x, y)
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
def hold(values, low, high, into):
    """Put values into `into`, limited; what is not a number stays so."""
    for i in range(values.size):
        value = values[i]
        if value < low[i]:
            value = low[i]
        elif value > high[i]:
            value = high[i]
        into[i] = value


@compiled
def standing(values):
    """Return whether all values are finite."""
    finite = 0
    for i in range(values.size):
        finite += np.isfinite(values[i])
    return finite == values.size


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
def advance(A, A_first, A_end, B, B_first, B_end, x, driven, work):
    """Make x into A x + B driven, computed in `work`."""
    for i in range(work.size):
        work[i] = 0.0
    add_product(A, A_first, A_end, x, work)
    add_product(B, B_first, B_end, driven, work)
    take(work, x)


@compiled
def loop(plant, law, code, signals, limits, state, xk, results):
    """Run on from `state` and the state of the law, both left where the samples end.

    Signals and results are `(samples, channels)`, A and B as `columns.spanned` lays them out, C and D by their columns.
    plant = (A, B, C, thresholds and weights of the plays), law = (A, B, C, D) with the state `xk`, signals =
    (actuation, disturbance, noise, gain of whatever is sent), limits = (commands, actuators, readings, step of the
    converter), state = (x, held commands, anchors of the plays), results = (commands, readings, counts of limited
    commands and actuators), all of them filled here.

    code = (addresses of the step of a law of machine code, of its state, of what it reads and gives, the arrays at the
    last two in the code's precision, and the places of these channels among the bench's); such a law adds to the
    linear one, and an address of 0 is none.
    """
    (A, A_first, A_end), (B, B_first, B_end), C, thresholds, weights = plant
    (KA, KA_first, KA_end), (KB, KB_first, KB_end), KC, KD = law
    law_step, law_state, at_readings, at_commands, readings, commands, reads, drives = code
    actuation, disturbance, noise, gain = signals
    sent, moved, seen, step = limits
    command, outputs, limited = results
    x, held, anchors = state
    sent_met, moved_met = limited[0], limited[1]
    asked, driven, y = np.empty(held.size), np.empty(held.size), np.empty(noise.shape[1])
    work, workk = np.empty(x.size), np.empty(xk.size)
    for k in range(len(actuation)):
        for i in range(y.size):
            y[i] = noise[k, i]
        read(C, x, seen, step, y)
        for i in range(y.size):
            outputs[k, i] = y[i]
        for i in range(asked.size):
            asked[i] = actuation[k, i]
            driven[i] = held[i] + gain[k] * disturbance[k, i]
        add_wide_product(KC, xk, asked)
        add_wide_product(KD, y, asked)
        advance(KA, KA_first, KA_end, KB, KB_first, KB_end, xk, y, workk)
        if law_step != 0:
            for i in range(readings.size):
                readings[i] = y[reads[i]]
            call_step(law_step, law_state, at_readings, at_commands)
            for i in range(commands.size):
                asked[drives[i]] += commands[i]
        clip(driven, moved, driven, moved_met)
        slip(thresholds, weights, anchors, driven)
        advance(A, A_first, A_end, B, B_first, B_end, x, driven, work)
        for i in range(asked.size):
            asked[i] *= gain[k]
        clip(asked, sent, held, sent_met)
        for i in range(asked.size):
            command[k, i] = held[i] + 0.0 * asked[i]  # no number where none was asked for


@compiled
def linear_loop(plant, law, code, limits, signals, state, results):
    """Run a linear plant and a linear law on from `state`; return before which sample either had no finite answer.

    Signals and results are `(samples, channels)`, matrices laid out as in `loop`. plant = (A, B, C, D, whether D acts),
    law = (A, B, C, D), code as in `loop`, limits = (lower and upper of commands, lower and upper of readings), signals
    = (actuation, disturbance, gain of whatever is sent), state = (x, state of the law, held commands), results =
    (commands before their limits, readings, the law's last answer), all of them filled here; readings that are not
    finite are the last ones, and the law is not asked.
    """
    (A, A_first, A_end), (B, B_first, B_end), C, D, direct = plant
    (KA, KA_first, KA_end), (KB, KB_first, KB_end), KC, KD = law
    law_step, law_state, at_readings, at_commands, heard, commands, reads, drives = code
    low, high, least, most = limits
    actuation, disturbance, gain = signals
    x, xk, held = state
    asked, readings, answer = results
    driven, y = np.empty(held.size), np.empty(least.size)
    work, workk = np.empty(x.size), np.empty(xk.size)
    for k in range(len(actuation)):
        for i in range(held.size):
            driven[i] = held[i] + disturbance[k, i]
            answer[i] = 0.0
        for i in range(y.size):
            y[i] = 0.0
        if direct:
            add_wide_product(C, x, y)
            add_wide_product(D, driven, y)
        advance(A, A_first, A_end, B, B_first, B_end, x, driven, work)
        if not direct:
            add_wide_product(C, x, y)
        hold(y, least, most, y)
        for i in range(y.size):
            readings[k, i] = y[i]
        if not standing(y):
            return k
        add_wide_product(KC, xk, answer)
        add_wide_product(KD, y, answer)
        advance(KA, KA_first, KA_end, KB, KB_first, KB_end, xk, y, workk)
        if law_step != 0:
            for i in range(heard.size):
                heard[i] = y[reads[i]]
            call_step(law_step, law_state, at_readings, at_commands)
            for i in range(commands.size):
                answer[drives[i]] += commands[i]
        for i in range(answer.size):
            if not np.isfinite(answer[i]):
                return k
            asked[k, i] = gain[k] * (actuation[k, i] + answer[i])
        hold(asked[k], low, high, held)
    return len(actuation)
