"""Stochastic systems declared as data: how each variable follows from the last step and this step's noises.

A system is a table of update rules, polynomials in real variables and noises times cosines and sines of angles, such
as `x + dt * v * cos(theta)`. The same table is simulated (`System.step`) and turned into exact moment dynamics
(`checkers.moment_closure`; Jasour et al. 2021, section V).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from checkers.expressions import Angle, Term, as_angle, parse
from checkers.validate import Array, InputError, as_scalar, shown

_HARMONICS = 32  # each multiple of an angle doubles what its wave expands to
_RESERVED = ("cos", "sin", "dt", "pi")


@dataclass(frozen=True)
class System:
    """A table of simultaneous updates: every right-hand side reads the values before the step.

    Variables inside a cosine or sine are angles; their own updates are sums of whole multiples of angles, multiples of
    noises and numbers. Noises are independent of each other and over time.

    Attributes:
        updates: variable -> rule, e.g. {"x": "x + dt * v * cos(theta)", …}; kept as a tuple of pairs.
        noises: names of the random inputs, drawn anew each step.
        dt: length of a step [s], the constant `dt` in the rules.
        position: the two real variables that are x and y in the world frame [m].
        name: label.

    Raises:
        InputError: for a rule that cannot be read, a name that is missing, or a system whose moments do not close.
    """

    updates: Any
    noises: tuple[str, ...]
    dt: float
    position: tuple[str, str] = ("x", "y")
    name: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "updates", _table(self.updates))
        put(self, "noises", _names("noises", self.noises))
        put(self, "position", _names("position", self.position))
        put(self, "dt", as_scalar("dt", self.dt, low=0.0, strict=True))
        if not isinstance(self.name, str):
            raise InputError(f"name: expected text, got {shown(self.name)}")
        for name in self.noises:
            if name in self.variables:
                raise InputError(f"noises: {name!r} is a variable too")
        if len(self.position) != 2 or any(p not in self.variables for p in self.position):
            known = ", ".join(self.variables)
            raise InputError(f"position: expected two of the variables {known}; got {list(self.position)}")
        self._check_kinds()
        check_closed(self)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names, in the order of the table."""
        return tuple(name for name, _ in self.updates)

    @cached_property
    def terms(self) -> dict[str, tuple[Term, ...]]:
        """The rules, read."""
        names = (*self.variables, *self.noises)
        constants = {"dt": self.dt, "pi": float(np.pi)}
        return {v: parse(text, f"updates[{v!r}]", names, constants) for v, text in self.updates}

    @cached_property
    def angles(self) -> tuple[str, ...]:
        """Variables that are angles: those in a cosine or sine, and those that such angles follow from."""
        inside = {n for terms in self.terms.values() for t in terms for _, angle in t.waves for n, _ in angle.multiples}
        while True:
            more = {n for v in inside & set(self.variables) for t in self.terms[v] for n in t.names} - inside
            if not more:
                return tuple(v for v in self.variables if v in inside)
            inside |= more

    @cached_property
    def reals(self) -> tuple[str, ...]:
        """The other variables."""
        return tuple(v for v in self.variables if v not in self.angles)

    @cached_property
    def turns(self) -> dict[str, Angle]:
        """The angles' updates."""
        return {a: as_angle(self.terms[a], f"updates[{a!r}]") for a in self.angles}

    @cached_property
    def noise_units(self) -> dict[str, float]:
        """The smallest multiple with which each noise enters an angle; every other is a whole multiple of it."""
        found: dict[str, list[float]] = {}
        angles = [angle for v in self.reals for t in self.terms[v] for _, angle in t.waves]
        for angle in (*angles, *self.turns.values()):
            for name, multiple in angle.multiples:
                if name in self.noises:
                    found.setdefault(name, []).append(abs(multiple))
        return {name: min(multiples) for name, multiples in found.items()}

    def step(self, values: Mapping[str, Array], draws: Mapping[str, Array]) -> dict[str, Array]:
        """One step of the system itself: values of the variables and draws of the noises, any common shape."""
        known = {**values, **draws}
        shape = np.broadcast_shapes(*(np.shape(v) for v in known.values()))
        return {
            v: np.broadcast_to(np.asarray(sum((t.at(known) for t in terms), start=0.0)), shape)
            for v, terms in self.terms.items()
        }

    def _check_kinds(self) -> None:
        for v in self.position:
            if v in self.angles:
                raise InputError(f"position: expected real variables, but {v!r} is an angle")
        units = self.noise_units
        for v in self.variables:
            where = f"updates[{v!r}]"
            used = [self.turns[v]] if v in self.angles else [a for t in self.terms[v] for _, a in t.waves]
            for name, multiple in (m for angle in used for m in angle.multiples):
                share = multiple / units.get(name, 1.0)
                if abs(share) > _HARMONICS:
                    raise InputError(f"{where}: expected at most {_HARMONICS} times the angle {name!r}, got {share:g}")
                if abs(share - round(share)) > 1e-9:
                    raise InputError(f"{where}: expected whole multiples of the angle {name!r}, got {share:g}")
            if v not in self.angles:
                for name in {n for t in self.terms[v] for n, _ in t.powers} & set(self.angles):
                    raise InputError(f"{where}: {name!r} is an angle and may stand inside cos and sin only")


def check_closed(system: System) -> None:
    """Refuse a system whose moments need ever more moments.

    A rule may multiply its own variable (or one that follows from it) by noises and numbers, and by nothing that
    remembers: `v * q` with a lasting q makes E[v] need E[v q], E[v q²], … without end.

    Raises:
        InputError: naming the rule and the moments that are missing.
    """
    reads = {v: {n for t in system.terms[v] for n in t.names if n in system.variables} for v in system.variables}
    reach = {v: set(reads[v]) for v in reads}
    for _ in reads:
        for v in reach:
            reach[v] |= {n for q in reach[v] for n in reach[q]}
    lasting = {v for v in reach if any(q in reach[q] for q in {v} | reach[v])}
    for v in system.variables:
        loop = {q for q in reach[v] if v in reach[q]}  # empty unless v follows from itself
        if not loop:
            continue
        if v in system.reals:
            for term in system.terms[v]:
                own = [n for n, p in term.powers for _ in range(p) if n in loop]
                grows = [n for n in sorted(term.names) if n in lasting and n not in loop]
                if len(own) > 1 or (own and grows):
                    raise _endless(v, own, grows or own[:1])
            continue
        grows = [n for n, _ in system.turns[v].multiples if n in lasting and n not in loop]
        own = [n for n, m in system.turns[v].multiples for _ in range(abs(round(m))) if n in loop]
        if grows or len(own) > 1:
            wave = " + i ".join(own + grows)
            raise InputError(
                f"updates[{v!r}]: not closed: E[exp(i {v})] needs E[exp(i {wave})], which needs more without end; "
                "an angle may follow from one lasting angle and from noises and numbers"
            )


def _endless(v: str, own: list[str], grows: list[str]) -> InputError:
    once = " ".join([*own, *(g for g in grows if g not in own)])
    return InputError(
        f"updates[{v!r}]: not closed: E[{v}] needs E[{once}], which needs E[{' '.join([once, *grows])}], and so on; "
        "only noises and numbers may multiply a variable in its own rule"
    )


def _table(updates: Any) -> tuple[tuple[str, Any], ...]:
    """A mapping, or the pairs it was kept as."""
    pairs = tuple(updates.items()) if isinstance(updates, Mapping) else updates
    if not isinstance(pairs, tuple) or not pairs or any(not isinstance(p, tuple) or len(p) != 2 for p in pairs):
        raise InputError(f"updates: expected a mapping from variables to rules, got {shown(updates)}")
    _names("updates", [name for name, _ in pairs])
    return pairs


def _names(field: str, value: Any) -> tuple[str, ...]:
    if isinstance(value, str | bytes) or not hasattr(value, "__iter__"):
        raise InputError(f"{field}: expected names, got {shown(value)}")
    names = tuple(value)
    for name in names:
        if not isinstance(name, str) or not name.isidentifier() or name in _RESERVED:
            raise InputError(f"{field}: expected names of variables and noises, not {shown(name)}")
    if len(set(names)) != len(names):
        raise InputError(f"{field}: expected different names, got {list(names)}")
    return names


def dubins(dt: float) -> System:
    """The paper's car (Jasour et al. 2021, eq. 20): x, y [m], v [m/s], theta [rad].

    Noises per step: w_v change of speed [m/s], w_theta change of heading [rad]. An acceleration a is w_v = a·dt.
    """
    return System(
        {"x": "x + dt*v*cos(theta)", "y": "y + dt*v*sin(theta)", "v": "v + w_v", "theta": "theta + w_theta"},
        ("w_v", "w_theta"),
        dt,
        name="dubins",
    )


def dubins_lateral(dt: float) -> System:
    """`dubins` whose position is also pushed sideways by w_lateral [m] each step."""
    car = dubins(dt)
    updates = dict(car.updates)
    updates["x"] += " - w_lateral*sin(theta)"
    updates["y"] += " + w_lateral*cos(theta)"
    return System(updates, (*car.noises, "w_lateral"), dt, name="dubins_lateral")


def unicycle(dt: float) -> System:
    """x, y [m], theta [rad], driven each step at the speed w_speed [m/s] and the turn rate w_turn [rad/s]."""
    return System(
        {
            "x": "x + dt*w_speed*cos(theta)",
            "y": "y + dt*w_speed*sin(theta)",
            "theta": "theta + dt*w_turn",
        },
        ("w_speed", "w_turn"),
        dt,
        name="unicycle",
    )


def dubins_3d(dt: float) -> System:
    """x, y, z [m], v [m/s], heading theta and climb gamma [rad]; noises w_v [m/s], w_theta, w_gamma [rad] per step.

    Risk is planar: the position is x, y; z is simulated and never enters a moment.
    """
    return System(
        {
            "x": "x + dt*v*cos(gamma)*cos(theta)",
            "y": "y + dt*v*cos(gamma)*sin(theta)",
            "z": "z + dt*v*sin(gamma)",
            "v": "v + w_v",
            "theta": "theta + w_theta",
            "gamma": "gamma + w_gamma",
        },
        ("w_v", "w_theta", "w_gamma"),
        dt,
        name="dubins_3d",
    )


def constant_turn(dt: float, turn_rate: float) -> System:
    """A car on a circle of known turn rate [rad/s] at an uncertain speed: x, y [m], v [m/s], theta [rad].

    The speed is uncertain from the start (give v a distribution) and changes by w_v [m/s] each step; the heading is
    taken half-way through the step.
    """
    rate = as_scalar("turn_rate", turn_rate)
    return System(
        {
            "x": f"x + dt*v*cos(theta + {rate / 2!r}*dt)",
            "y": f"y + dt*v*sin(theta + {rate / 2!r}*dt)",
            "v": "v + w_v",
            "theta": f"theta + {rate!r}*dt",
        },
        ("w_v",),
        dt,
        name="constant_turn",
    )
