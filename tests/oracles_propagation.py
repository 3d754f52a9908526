"""Oracles of moment propagation by other mathematics: raw complex moments in 60 digits, simulations by hand."""

from __future__ import annotations

from functools import lru_cache

import mpmath as mp
import numpy as np

DIGITS = 60


def normal_moment(mu, sd, n):
    """E[Xⁿ] of N(mu, sd²) in many digits."""
    mu, sd = mp.mpf(float(mu)), mp.mpf(float(sd))
    return mp.fsum(
        mp.binomial(n, 2 * k) * mu ** (n - 2 * k) * sd ** (2 * k) * mp.fac2(2 * k - 1) for k in range(n // 2 + 1)
    )


def normal_wave(mu, sd, k):
    """Φ(k) of N(mu, sd²)."""
    return mp.expj(k * mp.mpf(float(mu))) * mp.exp(-((k * mp.mpf(float(sd))) ** 2) / 2)


def uniform_moment(low, high, n):
    """E[Xⁿ] of a uniform distribution on [low, high]."""
    low, high = mp.mpf(float(low)), mp.mpf(float(high))
    return (high ** (n + 1) - low ** (n + 1)) / (n + 1) / (high - low)


def uniform_wave(low, high, k):
    """Φ(k) of a uniform distribution on [low, high]."""
    low, high = mp.mpf(float(low)), mp.mpf(float(high))
    return (mp.expj(k * high) - mp.expj(k * low)) / (1j * k * (high - low)) if k else mp.mpc(1)


FAMILIES = {"normal": (normal_moment, normal_wave), "uniform": (uniform_moment, uniform_wave)}


class DubinsOracle:
    """Raw moments E[ζ^a ζ̄^b v^c e^{ikθ}] of the Dubins car, ζ = x + iy from a known start, by the binomial theorem.

    Nothing is centred before the end: with 60 digits the cancellation does not matter.
    """

    def __init__(self, dt, speed, heading, speed_noise, turn_noise, order, family="normal"):
        """`speed_noise`, `turn_noise`: per step the two parameters of the family."""
        self.order = order
        moment, wave = FAMILIES[family]
        with mp.workdps(DIGITS):
            dt = mp.mpf(float(dt))
            self.v0, self.e0 = mp.mpf(float(speed)), mp.expj(mp.mpf(float(heading)))
            self.binomial = [[mp.binomial(n, k) for k in range(n + 1)] for n in range(order + 1)]
            self.lengths = [dt**k for k in range(2 * order + 1)]
            self.powers = [[moment(*p, n) for n in range(order + 1)] for p in speed_noise]
            self.waves = [[wave(*p, k) for k in range(order + 1)] for p in turn_noise]
        self.raw = lru_cache(None)(self._raw)

    def _raw(self, t, a, b, c, k):
        if t == 0:
            return self.v0**c * self.e0**k if a + b == 0 else mp.mpc(0)
        if a < b or (a == b and k < 0):
            return mp.conj(self.raw(t, b, a, c, -k))
        total = mp.mpc(0)
        noise = self.powers[t - 1]
        for i in range(a + 1):
            for j in range(b + 1):
                factor = self.binomial[a][i] * self.binomial[b][j] * self.lengths[i + j]
                speeds = [
                    self.binomial[c][n] * noise[n] * self.raw(t - 1, a - i, b - j, i + j + c - n, k + i - j)
                    for n in range(c + 1)
                    if noise[n] != 0
                ]
                total += factor * mp.fsum(speeds)
        wave = self.waves[t - 1][abs(k)]
        return total * (wave if k >= 0 else mp.conj(wave))

    def central(self, t):
        """Mean displacement (complex) and {(i, j): E[(x−μx)^i (y−μy)^j]} after t steps."""
        with mp.workdps(DIGITS):
            mean = self.raw(t, 1, 0, 0, 0)
            about = {
                (a, b): mp.fsum(
                    mp.binomial(a, i)
                    * mp.binomial(b, j)
                    * (-mean) ** (a - i)
                    * (-mp.conj(mean)) ** (b - j)
                    * self.raw(t, i, j, 0, 0)
                    for i in range(a + 1)
                    for j in range(b + 1)
                )
                for a in range(self.order + 1)
                for b in range(self.order + 1 - a)
            }
            out = {}
            for i in range(self.order + 1):
                for j in range(self.order + 1 - i):
                    total = mp.fsum(
                        mp.binomial(i, p) * mp.binomial(j, q) * (-1) ** (j - q) * about[p + q, i + j - p - q]
                        for p in range(i + 1)
                        for q in range(j + 1)
                    )
                    out[i, j] = (total / mp.mpf(2) ** (i + j) / mp.mpc(0, 1) ** j).real
            return mean, out


def simulated(name, dt, start, draws, turn_rate=0.0):
    """Positions (T + 1, n, 2) of the shipped systems, written by hand, from start (dict) and draws (dict of (T, n))."""
    x, y, theta = (np.array(start[k], dtype=float) for k in ("x", "y", "theta"))
    v = np.array(start.get("v", 0.0), dtype=float)
    gamma = np.array(start.get("gamma", 0.0), dtype=float)
    path = [np.stack([x, y], axis=-1)]
    for t in range(len(next(iter(draws.values())))):
        now = {k: d[t] for k, d in draws.items()}
        along, across, heading = v * dt, 0.0, theta
        if name == "unicycle":
            along = now["w_speed"] * dt
            theta = theta + now["w_turn"] * dt
        if name == "dubins_3d":
            along = along * np.cos(gamma)
            gamma = gamma + now["w_gamma"]
        if name == "dubins_lateral":
            across = now["w_lateral"]
        if name == "constant_turn":
            heading = theta + 0.5 * turn_rate * dt
            theta = theta + turn_rate * dt
        if name.startswith("dubins"):
            theta = theta + now["w_theta"]
        if name != "unicycle":
            v = v + now["w_v"]
        step = (along + 1j * across) * np.exp(1j * heading)
        x, y = x + step.real, y + step.imag
        path.append(np.stack([x, y], axis=-1))
    return np.array(path)
