"""Backends by name."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from checkers.base import Checker, CheckerInfo
from checkers.validate import InputError, as_option

# adding a backend: one file, one line
BACKENDS = {
    "exact": "exact:Exact",
    "imhof": "imhof:Imhof",
    "liu": "liu:Liu",
    "chebyshev": "chebyshev:Chebyshev",
    "halfspace": "halfspace:HalfSpace",
    "marshall-olkin": "marshall_olkin:MarshallOlkin",
    "unimodal-halfspace": "unimodal:UnimodalHalfSpace",
    "sos": "sos:Sos",
    "projected-sos": "projected_sos:ProjectedSos",
    "offline-sos": "offline_sos:OfflineSos",
    "bivariate-sos": "bivariate_sos:BivariateSos",
    "cascade": "cascade:Cascade",
    "monte-carlo": "monte_carlo:MonteCarlo",
}


def checkers() -> dict[str, CheckerInfo]:
    """What each backend declares: kind, what it needs of the agent, assumption, source, cost."""
    return {name: _load(name).info for name in BACKENDS}


def checker(name: str, **options: Any) -> Checker:
    """The backend of that name with its options, e.g. `checker("sos", order=6, solver="clarabel")`.

    Raises:
        InputError: for an unknown name or option, listing the valid ones, or a bad value.
    """
    as_option("checker", name, tuple(BACKENDS))
    cls = _load(name)
    valid = list(cls.defaults())
    for option in options:
        if option not in valid:
            known = f"expected one of {', '.join(valid)}" if valid else "it has none"
            raise InputError(f"{name}: unknown option {option!r}; {known}")
    return cls(**options)


def _load(name: str) -> type[Checker]:
    module, cls = BACKENDS[name].split(":")
    found: type[Checker] = getattr(import_module(f"checkers.backends.{module}"), cls)
    return found
