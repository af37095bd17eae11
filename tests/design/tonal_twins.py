"""The adaptive laws once more, in plain NumPy and without a thought for speed: what the kernels must do."""

import numpy as np


class FeedforwardTwin:
    """Bank, frequency-locked loops and cancellation; reads the settings of a `FeedforwardLaw`."""

    def __init__(self, law):
        self.A, self.B, self.C, self.D = law._system
        (
            self.bins,
            self.searched,
            self.rates,
            self.limits,
            self.gains,
            self.edges,
            self.speeds,
            self.table,
            self.most,
            self.every,
        ) = law._design
        nt, nb = self.bins.shape
        ny, nu = self.D.shape
        self.x, self.k = np.zeros(len(self.A)), 0
        self.w, self.slope, self.on = law._nominal.copy(), np.zeros(nt), np.zeros(nt, bool)
        self.first, self.second = np.zeros((2, nt, nb, ny), complex)
        self.copies, self.zeta = np.zeros((nt, ny), complex), np.zeros((nt, nu), complex)

    def step(self, y):
        v = np.clip(self.zeta.real.sum(axis=0), -self.most, self.most)
        y0 = y - self.C @ self.x - self.D @ v
        self.x = self.A @ self.x + self.B @ v
        error = y0 - self.copies.real.sum(axis=0)
        self.k += 1
        for i in range(len(self.w)):
            heard = error + self.copies[i].real
            turned = heard * np.exp(-1j * self.bins[i] * self.k)[:, None]
            self.first[i] += self.rates[i] * (turned - self.first[i])
            self.second[i] += self.rates[i] * (self.first[i] - self.second[i])
            if self.k % self.every == 0:
                self.judge(i, np.sum(np.abs(self.second[i]) ** 2, axis=1))
        for i in range(len(self.w)):
            self.follow(i, error)
            self.cancel(i, y)
        share = np.min(self.most / np.maximum(np.abs(self.zeta).sum(axis=0), 1e-300))
        self.zeta *= min(share, 1.0)
        return v

    def judge(self, i, powers):
        low, high = self.searched[i]
        top = low + int(np.argmax(powers[low:high]))
        far = np.abs(np.arange(powers.size) - top) > 2
        ratio = powers[top] / max(powers[far].mean(), 1e-300 / far.sum())
        near = int(
            np.clip(np.rint((self.w[i] - self.bins[i, 0]) / (self.bins[i, 1] - self.bins[i, 0])), 0, far.size - 1)
        )
        lost = abs(top - near) > 3 and powers[near] < self.limits[2] * powers[top]
        restart = ratio > self.limits[0] and (not self.on[i] or lost)
        if restart:
            self.on[i] = True
        elif ratio < self.limits[1]:
            self.on[i] = False
        if restart or not self.on[i]:
            self.w[i], self.slope[i] = self.bins[i, top], 0.0

    def follow(self, i, error):
        x = self.copies[i]
        if self.on[i]:
            q = np.clip(-(error @ x.imag) / (np.sum(np.abs(x) ** 2) + 1e-300), -1, 1)
            self.slope[i] += self.gains[2] * q
            moved = self.w[i] + self.slope[i] + self.gains[1] * q
            self.w[i] = np.clip(moved, *self.edges[i])
            if self.w[i] != moved:
                self.slope[i] = 0.0
        self.copies[i] = np.exp(1j * self.w[i]) * (x + self.gains[0] * error)

    def cancel(self, i, y):
        inverses, start, step = self.table
        grid = start[i] + step[i] * np.arange(inverses.shape[1])
        a, rho, fading = self.speeds[i]
        drive = 0.0
        if self.on[i]:
            entries = inverses[i].reshape(grid.size, -1)
            M = [np.interp(self.w[i], grid, e.real) + 1j * np.interp(self.w[i], grid, e.imag) for e in entries.T]
            drive = np.array(M).reshape(inverses.shape[2:]) @ y
        self.zeta[i] = np.exp(1j * self.w[i]) * ((rho if self.on[i] else fading) * self.zeta[i] - 2 * a * drive)


class YoulaTwin:
    """Observer, Q and recursive least squares; reads the settings of a `YoulaLaw`."""

    def __init__(self, law):
        self.A, self.B, self.C, self.D = law._seen
        self.F, self.L = law._gains
        self.T, self.filters, self.most = law._regress, law._filters, law.limit
        self.every, self.forget, self.leak, self.floor = law._settings
        self.m, self.nu, self.ny = law._theta.shape
        p = law._theta.size
        self.theta, self.P, self.k, self.power = np.zeros(p), np.eye(p) / self.floor, 0, self.floor
        self.x, self.xt = np.zeros(len(self.A)), np.zeros(len(self.T[0]))
        self.psi = np.zeros((self.ny, self.m))
        self.X = np.zeros((len(self.T[0]), self.nu, self.ny))
        self.phi = np.zeros((self.ny, self.nu, self.ny, self.m))

    def step(self, y):
        theta = self.theta.reshape(self.m, self.nu, self.ny)
        added = np.einsum("kij,jk->i", theta, self.psi)
        wanted = self.F @ self.x + added
        v = np.clip(wanted, -self.most, self.most)
        added = added + v - wanted
        e = y - self.C @ self.x - self.D @ v
        self.x = self.A @ self.x + self.B @ v + self.L @ e
        Af, bf = self.filters
        self.psi = self.psi @ Af.T + np.outer(e, bf)
        A, B, C, D = self.T
        y0 = y - C @ self.xt - D @ added
        self.xt = A @ self.xt + B @ added
        driven = np.einsum("cs,sij->cij", C, self.X) + D[:, :, None] * e
        self.X = np.einsum("st,tij->sij", A, self.X) + B[:, :, None] * e
        self.learn(self.phi.transpose(0, 3, 1, 2).reshape(self.ny, -1), y0)
        self.phi = self.phi @ Af.T + driven[..., None] * bf
        return v

    def learn(self, phi, y0):
        self.k += 1
        if self.k % int(self.every):
            return
        p = self.theta.size
        self.power = max(self.forget * self.power + (1 - self.forget) * np.sum(phi**2) / p, self.floor)
        extra = np.zeros((1, p))
        extra[0, (self.k // int(self.every)) % p] = np.sqrt((1 - self.forget) * p * self.leak * self.power)
        rows = np.vstack([phi, extra])
        K = self.P @ rows.T @ np.linalg.inv(self.forget * np.eye(len(rows)) + rows @ self.P @ rows.T)
        self.theta = self.theta - K @ (np.append(y0, 0.0) + rows @ self.theta)
        self.P = (self.P - K @ rows @ self.P) / self.forget
        self.P = (self.P + self.P.T) / 2


class FilteredXTwin:
    """References, their windows and the projection; reads the settings of a `FilteredXLaw`."""

    def __init__(self, law):
        self.A, self.B, self.C, self.D = law._system
        self.errors, self.references = law._channels
        self.most, (self.rate, self.leak, self.floor), self.lead = law._design
        self.nu, self.taps = law._drives.size, law._taps
        nr, ne = self.references.size, self.errors.size
        self.w = np.zeros((self.nu, nr, self.taps))
        self.heard, self.windows = np.zeros((nr, self.taps)), np.zeros((ne, self.nu, nr, self.taps))
        self.x, self.X = np.zeros(len(self.A)), np.zeros((len(self.A), self.nu, nr))

    def step(self, y):
        ne, late = self.errors.size, slice(self.lead, None)
        self.heard = np.roll(self.heard, 1, axis=1)
        self.heard[:, 0] = y[self.references] - (self.C @ self.x)[ne:]
        wanted = np.einsum("irk,rk->i", self.w[..., late], self.heard[:, late])
        v = np.clip(wanted, -self.most, self.most)
        own = self.C @ self.x + self.D @ v
        self.heard[:, 0] = y[self.references] - own[ne:]
        y0 = y[self.errors] - own[:ne]
        self.windows = np.roll(self.windows, 1, axis=3)
        fresh = np.einsum("cs,sir->cir", self.C, self.X) + self.D[:, :, None] * self.heard[:, 0]
        self.windows[..., 0] = fresh[:ne]
        self.x = self.A @ self.x + self.B @ v
        self.X = np.einsum("st,tir->sir", self.A, self.X) + self.B[:, :, None] * self.heard[:, 0]
        F = self.windows[..., late].reshape(ne, -1)
        self.w = (1 - self.leak) * self.w
        if np.array_equal(wanted, v):
            S = F @ F.T
            S += (self.floor + 1e-3 * np.trace(S) / ne) * np.eye(ne)
            shares = np.linalg.solve(S, y0 + F @ self.w[..., late].reshape(-1))
            self.w[..., late] -= self.rate * (F.T @ shares).reshape(self.w[..., late].shape)
        return v
