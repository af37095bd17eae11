"""The sampled loop, compiled. Import where it is used: numba costs half a second."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=False)
def read(C, x, noise, limit, step, y):
    """Fill y with the readings C x + noise, clipped to +-limit and rounded to multiples of step (0: not rounded)."""
    for i in range(y.size):
        value = noise[i]
        for j in range(x.size):
            value += C[i, j] * x[j]
        value = min(max(value, -limit), limit)
        y[i] = step * np.rint(value / step) if step > 0.0 else value


@njit(cache=True, nogil=True, fastmath=False)
def add_product(At, x, out):
    """Add A x to out; At is A transposed, so that the inner loop runs along memory."""
    for j in range(x.size):
        value = x[j]
        for i in range(out.size):
            out[i] += At[j, i] * value


@njit(cache=True, nogil=True, fastmath=False)
def clip(values, limit, into, counts):
    """Put values limited to +-limit into `into`, counting those limited."""
    for i in range(values.size):
        if values[i] > limit or values[i] < -limit:
            counts[i] += 1
        into[i] = min(max(values[i], -limit), limit)


@njit(cache=True, nogil=True, fastmath=False)
def slip(thresholds, weights, anchors, values):
    """Send values through plays: each anchor is dragged along once its value is a threshold away."""
    if weights.size == 0:
        return
    for i in range(values.size):
        total = 0.0
        for j in range(weights.size):
            anchors[i, j] = min(max(anchors[i, j], values[i] - thresholds[j]), values[i] + thresholds[j])
            total += weights[j] * anchors[i, j]
        values[i] = total


@njit(cache=True, nogil=True, fastmath=False)
def move(plant, x, anchors, held, disturbance, stack_limit, stack, work, counts):
    """Advance the plant one sample under the held command plus the disturbance, the stack limited to +-stack_limit."""
    At, Bt, _, thresholds, weights = plant
    for i in range(held.size):
        stack[i] = held[i] + disturbance[i]
    clip(stack, stack_limit, stack, counts)
    slip(thresholds, weights, anchors, stack)
    work[:] = 0.0
    add_product(At, x, work)
    add_product(Bt, stack, work)
    x[:] = work


@njit(cache=True, nogil=True, fastmath=False)
def loop(plant, law, actuation, disturbance, noise, limits, command, outputs, limited):
    """Run all samples; signals are `(n, channels)`, matrices transposed but for the plant's C.

    plant = (At, Bt, C, thresholds and weights of the plays), law = (At, Bt, Ct, Dt),
    limits = (command, stack, reading, step of the converter).
    """
    Kat, Kbt, Kct, Kdt = law
    n, nu = actuation.shape
    x, work = np.zeros(plant[0].shape[0]), np.zeros(plant[0].shape[0])
    anchors = np.zeros((nu, plant[4].size))
    xk, workk = np.zeros(Kat.shape[0]), np.zeros(Kat.shape[0])
    asked, held, stack = np.zeros(nu), np.zeros(nu), np.zeros(nu)
    for k in range(n):
        read(plant[2], x, noise[k], limits[2], limits[3], outputs[k])
        asked[:] = actuation[k]
        add_product(Kct, xk, asked)
        add_product(Kdt, outputs[k], asked)
        workk[:] = 0.0
        add_product(Kat, xk, workk)
        add_product(Kbt, outputs[k], workk)
        xk[:] = workk
        move(plant, x, anchors, held, disturbance[k], limits[1], stack, work, limited[1])
        clip(asked, limits[0], held, limited[0])
        command[k] = held
