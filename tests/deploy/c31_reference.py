"""The law in the C31's arithmetic, in NumPy: what the emitted code ought to compute, written from the equations."""

import c31_numbers as num
import numpy as np


class Reference:
    """One law with its states; numbers are float64 that hold C31 words."""

    def __init__(self, law):
        self.law = law
        self.x = np.zeros(law.states)
        self.gain = np.concatenate([law.C, law.D], axis=1).astype(float)
        self.own = np.concatenate(law.blocks, axis=0).astype(float)
        self.drive = law.B if law.L is None else np.concatenate([law.B, law.L], axis=1)
        self.drive = self.drive.astype(float)
        self.channel = np.repeat(np.arange(len(law.channels)), 2 * np.array(law.channels, dtype=int))
        self.backwards = (law.outputs - np.arange(law.outputs)) % 2 == 1

    def output(self, y):
        """Return D y + C x, every second row summed from its end, the last one always."""
        if self.law.channels:
            return num.np_rounded(np.array([self._channel(c, y[c]) for c in range(len(y))]))
        products = num.np_multiply(self.gain, np.concatenate([self.x, y]))
        products = np.where(self.backwards[:, None], products[:, ::-1], products)
        return num.np_rounded(_sum(products))

    def _channel(self, c, y):
        own = self.channel == c
        products = num.np_multiply(
            np.append(self.law.C[c, own], self.law.D[c, c]).astype(float), np.append(self.x[own], y)
        )
        return _sum(products[None, :])[0]

    def update(self, y, raw, limited):
        """Advance: own state, first measurement, other state, other measurements, corrections."""
        gap = num.cut(num.np_add(limited, -raw), 23)
        seen = y if self.law.L is None else np.concatenate([y, gap])
        pair = np.repeat(self.x.reshape(-1, 2), 2, axis=0)
        own, drive = num.np_multiply(self.own, pair), num.np_multiply(self.drive, seen)
        if self.law.channels:
            mine = [self.channel] if self.law.L is None else [self.channel, self.channel + len(y)]
            drive = np.stack([drive[np.arange(len(self.x)), columns] for columns in mine], axis=1)
        total = _sum(np.concatenate([own[:, :1], drive[:, :1], own[:, 1:], drive[:, 1:]], axis=1))
        self.x = num.np_rounded(num.np_add(self.x, total) if self.law.delta else total)


def _sum(products):
    total = products[:, 0]
    for k in range(1, products.shape[1]):
        total = num.np_add(products[:, k], total)
    return total
