"""One sample of every adaptive law, compiled. Import where it is used: numba costs half a second.

All arrays are C-contiguous and changed in place where a docstring says so; `work` is scratch.
"""

import numpy as np

from ultraquiet._base.compiled import compiled
from ultraquiet._base.compiled_arrays import copy_matrix, copy_vector, solve_positive


@compiled
def product(M, x, out):
    """Add M x to out."""
    for i in range(M.shape[0]):
        total = 0.0
        for j in range(M.shape[1]):
            total += M[i, j] * x[j]
        out[i] += total


@compiled
def linear_step(system, x, work, u, y):
    """Fill y with C x + D u and move x on to A x + B u."""
    A, B, C, D = system
    y[:] = 0.0
    product(C, x, y)
    product(D, u, y)
    work[:] = 0.0
    product(A, x, work)
    product(B, u, work)
    copy_vector(work, x)


@compiled
def limit(v, most):
    """Hold v within +-most; return how many entries were beyond. What is not a number stays so, to be seen."""
    met = 0
    for i in range(v.size):
        if abs(v[i]) > most[i]:
            met += 1
            v[i] = most[i] if v[i] > 0 else -most[i]
    return met


# ---- adaptive feedforward: a bank that finds tones, loops that follow them, amplitudes that cancel them ----


@compiled
def search(signal, bins_w, rates, i, bank, looked):
    """Move tone i's bank of two-stage demodulators on by one sample of `signal` `(ny,)`; fill powers when `looked`."""
    phasors, first, second, powers = bank
    beta = rates[i]
    for b in range(bins_w.shape[1]):
        phasors[i, b] *= np.exp(-1j * bins_w[i, b])
        for c in range(signal.size):
            first[i, b, c] += beta * (signal[c] * phasors[i, b] - first[i, b, c])
            second[i, b, c] += beta * (first[i, b, c] - second[i, b, c])
    if looked:
        for b in range(bins_w.shape[1]):
            size = abs(phasors[i, b])
            phasors[i, b] /= size
            powers[i, b] = 0.0
            for c in range(signal.size):
                powers[i, b] += second[i, b, c].real ** 2 + second[i, b, c].imag ** 2


@compiled
def judge(bins_w, searched, i, powers, thresholds, follow):
    """Decide whether tone i is there, and set its frequency where the bank knows better than the loop that follows it.

    The loudest bin of the searched ones is compared with the mean of all that are at least three bins away from it.
    """
    w, slope, on, ratio = follow
    top = searched[i, 0]
    for b in range(searched[i, 0], searched[i, 1]):
        if powers[i, b] > powers[i, top]:
            top = b
    rest, count = 0.0, 0
    for b in range(bins_w.shape[1]):
        if abs(b - top) > 2:
            rest += powers[i, b]
            count += 1
    ratio[i] = powers[i, top] * count / max(rest, 1e-300)
    spacing = bins_w[i, 1] - bins_w[i, 0]
    near = min(max(int(np.rint((w[i] - bins_w[i, 0]) / spacing)), 0), bins_w.shape[1] - 1)
    lost = abs(top - near) > 3 and powers[i, near] < thresholds[2] * powers[i, top]
    if ratio[i] > thresholds[0] and (on[i] == 0 or lost):
        on[i] = 1
        w[i] = bins_w[i, top]
        slope[i] = 0.0
    elif ratio[i] < thresholds[1]:
        on[i] = 0
    if on[i] == 0:
        w[i] = bins_w[i, top]
        slope[i] = 0.0


@compiled
def pull(error, tones, i, gains, edges, follow):
    """Let tone i's copy `(ny,)` and its frequency follow: a frequency-locked loop of second order, common to channels.

    x+ = e^jw (x + k e), w+ = w + slope + g1 q, slope+ = slope + g2 q, q = sum_c e_c (-Im x_c) / sum_c |x_c|^2.
    """
    w, slope, on, _ = follow
    turned, size = 0.0, 1e-300
    for c in range(error.size):
        turned -= error[c] * tones[i, c].imag
        size += tones[i, c].real ** 2 + tones[i, c].imag ** 2
    if on[i] == 1:
        q = min(max(turned / size, -1.0), 1.0)
        slope[i] += gains[2] * q
        w[i] += slope[i] + gains[1] * q
        if w[i] < edges[i, 0] or w[i] > edges[i, 1]:
            w[i] = min(max(w[i], edges[i, 0]), edges[i, 1])
            slope[i] = 0.0
    for c in range(error.size):
        tones[i, c] = np.exp(1j * w[i]) * (tones[i, c] + gains[0] * error[c])


@compiled
def cancel(y, i, w, on, speeds, table, amplitudes):
    """Move tone i's command on: zeta+ = e^jw (rho zeta - 2 a G(w)^-1 y), G^-1 interpolated; off, it fades."""
    inverses, start, step = table
    turn = np.exp(1j * w)
    a, rho, fading = speeds[i, 0], speeds[i, 1], speeds[i, 2]
    place = min(max((w - start[i]) / step[i], 0.0), inverses.shape[1] - 1.000001)
    k = int(place)
    t = place - k
    for r in range(amplitudes.shape[1]):
        drive = 0.0j
        if on == 1:
            for c in range(y.size):
                drive += ((1.0 - t) * inverses[i, k, r, c] + t * inverses[i, k + 1, r, c]) * y[c]
        amplitudes[i, r] = turn * ((rho if on == 1 else fading) * amplitudes[i, r] - 2.0 * a * drive)


@compiled
def feedforward_step(y, system, design, state, v, y0):
    """One sample of adaptive feedforward: fills v (commands) and y0 (readings without them); returns limits met."""
    bins_w, searched, rates, thresholds, gains, edges, speeds, table, most, every = design
    x, work, count, bank, follow, tones, amplitudes, error, wanted = state
    nt = amplitudes.shape[0]
    v[:] = 0.0
    for i in range(nt):
        for r in range(v.size):
            v[r] += amplitudes[i, r].real
    met = limit(v, most)
    linear_step(system, x, work, v, y0)
    for c in range(y.size):
        y0[c] = y[c] - y0[c]
        error[c] = y0[c]
        for i in range(nt):
            error[c] -= tones[i, c].real
    count[0] += 1
    for i in range(nt):
        for c in range(y.size):
            wanted[c] = error[c] + tones[i, c].real
        looked = count[0] % every == 0
        search(wanted, bins_w, rates, i, bank, looked)
        if looked:
            judge(bins_w, searched, i, bank[3], thresholds, follow)
    for i in range(nt):
        pull(error, tones, i, gains, edges, follow)
        cancel(y, i, follow[0][i], follow[2][i], speeds, table, amplitudes)
    return met + confine(amplitudes, most)


@compiled
def confine(amplitudes, most):
    """Shrink all amplitudes together until no actuator can be asked for more than `most`; return whether it had to."""
    share = 1.0
    for r in range(most.size):
        total = 0.0
        for i in range(amplitudes.shape[0]):
            total += abs(amplitudes[i, r])
        if total > most[r]:
            share = min(share, most[r] / total)
    if share < 1.0:
        amplitudes *= share
        return 1
    return 0


# ---- Youla-Kucera: innovations, a stable Q on them, its parameters by recursive least squares ----


@compiled
def youla_step(y, models, most, rls, state, v, y0):
    """One sample of the law: fills v (what state feedback and Q add) and y0 (readings with Q = 0); returns limits met.

    models = (A, B, C, D of the plant), (F, L), (A, B, C, D of T, from what Q adds to y), (A, b of the filters of Q).
    """
    seen, (F, L), regress, (Af, bf) = models
    x, work, added, innovation, filters, theta, total = state[0]
    XT, XT_new, filtered, phi, spare = state[1]
    nm, nu, ny = theta.shape
    added[:] = 0.0
    for k in range(nm):
        for i in range(nu):
            for j in range(ny):
                added[i] += theta[k, i, j] * filters[j, k]
    copy_vector(added, total)
    product(F, x, total)
    copy_vector(total, v)
    met = limit(v, most)
    added += v - total  # what the limits take is taken from Q's share
    linear_step(seen, x, work, v, innovation)
    for j in range(ny):
        innovation[j] = y[j] - innovation[j]
    product(L, innovation, x)
    for j in range(ny):
        advance(Af, bf, innovation[j], filters[j], spare)
    drive_regressors(regress, XT, XT_new, innovation, added, filtered, y, y0)
    last = nu * ny
    for c in range(ny):
        for column in range(last):
            for k in range(nm):
                phi[c, k * last + column] = filtered[c, column, 1 + k]
            advance(Af, bf, filtered[c, column, 0], filtered[c, column, 1:], spare)
    recursive_least_squares(phi, y0, theta.reshape(-1), rls)
    return met


@compiled
def advance(A, b, value, x, spare):
    """Move x on to A x + b value."""
    for i in range(b.size):
        spare[i] = b[i] * value
    product(A, x, spare)
    copy_vector(spare, x)


@compiled
def drive_regressors(regress, XT, XT_new, innovation, added, filtered, y, y0):
    """Fill filtered[:, :, 0] with T[:, i] innovation_j, a column for each pair (i, j), and y0 with y - T added."""
    A, B, C, D = regress
    nu, ny = added.size, innovation.size
    last = nu * ny
    out = np.dot(C, XT)
    for c in range(ny):
        y0[c] = y[c] - out[c, last]
        for i in range(nu):
            y0[c] -= D[c, i] * added[i]
            for j in range(ny):
                filtered[c, i * ny + j, 0] = out[c, i * ny + j] + D[c, i] * innovation[j]
    np.dot(A, XT, XT_new)
    for s in range(XT.shape[0]):
        for i in range(nu):
            XT_new[s, last] += B[s, i] * added[i]
            for j in range(ny):
                XT_new[s, i * ny + j] += B[s, i] * innovation[j]
    copy_matrix(XT_new, XT)


@compiled
def recursive_least_squares(phi, y0, theta, rls):
    """Every few samples: theta minimises the forgotten sum of |y0 + phi theta|^2 + leak |theta|^2.

    One extra row a step, on each parameter in turn, carries the leak and keeps P bounded whatever is not excited.
    """
    P, settings, turn, power = rls
    every, forget, leak, floor = settings
    turn[0] += 1
    if turn[0] % int(every) != 0:
        return
    p = theta.size
    fresh = 0.0
    for c in range(phi.shape[0]):
        for k in range(p):
            fresh += phi[c, k] * phi[c, k]
    power[0] = max(forget * power[0] + (1.0 - forget) * fresh / p, floor)
    G = np.dot(P, phi.T)
    S = np.dot(phi, G)
    for c in range(S.shape[0]):
        S[c, c] += forget
    error = y0 + np.dot(phi, theta)
    KT = G.T.copy()
    solve_positive(S, KT)
    K = KT.T.copy()
    theta -= np.dot(K, error)
    P -= np.dot(K, G.T)
    k = (turn[0] // int(every)) % p
    weight = (1.0 - forget) * p * leak * power[0]
    column = P[:, k].copy()
    gain = weight / (forget + weight * column[k])
    pulled = theta[k]
    for a in range(p):
        theta[a] -= gain * column[a] * pulled
        for b in range(p):
            P[a, b] -= gain * column[a] * column[b]
    for a in range(p):
        for b in range(a + 1):
            mean = 0.5 * (P[a, b] + P[b, a]) / forget
            P[a, b] = mean
            P[b, a] = mean


# ---- filtered-x LMS ----


@compiled
def filtered_x_step(y, system, channels, design, state, v, y0):
    """One sample of multi-error filtered-x LMS: fills v and y0 (errors without v); returns limits met.

    channels = (errors, references), indices of readings; the model's outputs are errors, then references. Its columns
    are driven by reference r through actuator i, the last one by v. With a direct part, `lead` is one: commands then
    use the references of the samples before only.
    """
    A, B, C, D = system
    errors, references = channels
    most, tuning, lead = design
    (x, x_new, out), (heard, windows, gram), weights, place = state
    ne, nr, nu, taps = errors.size, references.size, v.size, weights.shape[1]
    last = nu * nr
    p = (place[0] - 1) % taps
    place[0] = p
    np.dot(C, x, out)
    for r in range(nr):
        heard[r, p] = y[references[r]] - out[ne + r, last]
        heard[r, p + taps] = heard[r, p]
    v[:] = 0.0
    for i in range(nu):
        for r in range(nr):
            for k in range(lead, taps):
                v[i] += weights[i * nr + r, k] * heard[r, p + k]
    met = limit(v, most)
    for o in range(ne + nr):
        direct = out[o, last]
        for i in range(nu):
            direct += D[o, i] * v[i]
        if o < ne:
            y0[o] = y[errors[o]] - direct
        else:
            heard[o - ne, p] = y[references[o - ne]] - direct
            heard[o - ne, p + taps] = heard[o - ne, p]
    slide(windows, gram, out, D, heard, p, lead)
    np.dot(A, x, x_new)
    for s in range(x.shape[0]):
        for i in range(nu):
            x_new[s, last] += B[s, i] * v[i]
            for r in range(nr):
                x_new[s, i * nr + r] += B[s, i] * heard[r, p]
    copy_matrix(x_new, x)
    descend(windows, gram, weights, y0, p, lead, tuning, met)
    return met


@compiled
def slide(windows, gram, out, D, heard, p, lead):
    """Put this sample's filtered references into their windows, and the windows' products into the Gram matrix."""
    ne, columns, taps = windows.shape[0], windows.shape[1], windows.shape[2] // 2
    nr = heard.shape[0]
    for column in range(columns):
        i, r = column // nr, column % nr
        for o in range(ne):
            out[o, column] += D[o, i] * heard[r, p]
        # entering is the sample that is `lead` old, leaving the one that `taps` samples ago came in at its place
        for a in range(ne):
            for b in range(ne):
                new = out[a, column] * out[b, column]
                if lead == 1:
                    new = windows[a, column, p + 1] * windows[b, column, p + 1]
                gram[a, b] += new - windows[a, column, p] * windows[b, column, p]
        for o in range(ne):
            windows[o, column, p] = out[o, column]
            windows[o, column, p + taps] = out[o, column]
    if p == 0:  # once a window, so that rounding does not add up
        gram[:] = 0.0
        for a in range(ne):
            for b in range(ne):
                for column in range(columns):
                    for k in range(lead, taps):
                        gram[a, b] += windows[a, column, k] * windows[b, column, k]


@compiled
def descend(windows, gram, weights, y0, p, lead, tuning, met):
    """Move the weights: w+ = (1 - leak) w - step F' (F F' + floor)^-1 (y0 + F w); at a limit they only leak."""
    step, leak, floor = tuning
    ne = y0.size
    columns, taps = weights.shape
    weights *= 1.0 - leak
    if met > 0:
        return
    modified = y0.copy().reshape(ne, 1)
    S = gram.copy()
    for o in range(ne):
        S[o, o] += floor + 1e-3 * np.trace(gram) / ne
        for column in range(columns):
            for k in range(lead, taps):
                modified[o, 0] += weights[column, k] * windows[o, column, p + k]
    solve_positive(S, modified)
    for column in range(columns):
        for o in range(ne):
            share = step * modified[o, 0]
            for k in range(lead, taps):
                weights[column, k] -= share * windows[o, column, p + k]
