"""The sampled loop in plain NumPy: the twin that the compiled kernel is held against."""

import numpy as np

STACKS = 6


def limited(values, limit):
    return np.clip(values, -limit, limit), np.abs(values) > limit


def plain_loop(plant, law, actuation, disturbance, noise, limits, gain=None):
    """Return commands, readings and counts of limited commands and actuators; signals are `(n, channels)`.

    The first six actuators are stacks and have plays; `gain` `(n,)` fades whatever is sent.
    """
    A, B, C, thresholds, weights = plant
    Ak, Bk, Ck, Dk = law
    command_limit, stack_limit, reading_limit, step = limits
    x, xk, held = np.zeros(len(A)), np.zeros(len(Ak)), np.zeros(B.shape[1])
    command, outputs = np.empty_like(actuation), np.empty((len(actuation), len(C)))
    counts = np.zeros((2, B.shape[1]))
    anchors = np.zeros((STACKS, len(weights)))
    gain = np.ones(len(actuation)) if gain is None else gain
    for k in range(len(actuation)):
        y = np.clip(C @ x + noise[k], -reading_limit, reading_limit)
        outputs[k] = step * np.round(y / step) if step else y
        asked = gain[k] * (actuation[k] + Ck @ xk + Dk @ outputs[k])
        xk = Ak @ xk + Bk @ outputs[k]
        stack, over = limited(held + gain[k] * disturbance[k], stack_limit)
        counts[1] += over
        if len(weights):
            at = stack[:STACKS, None]
            anchors = np.clip(anchors, at - thresholds, at + thresholds)
            stack[:STACKS] = anchors @ weights
        x = A @ x + B @ stack
        held, over = limited(asked, command_limit)
        counts[0] += over
        command[k] = held
    return command, outputs, counts
