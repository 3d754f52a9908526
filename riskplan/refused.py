"""What OMPL 2.0.1 offers that cannot hold a bound on the risk, and why: asking for it by name tells."""

from __future__ import annotations

_BACKWARD = "keeps edges backward in time, along which no risk can be accumulated"
_GOAL_TREE = "grows a tree from the goal, whose arrival time and hence whose risk is not known"
_SYMMETRIC = "its roadmap's edges go both ways, also backward in time; `prm` builds directed ones"
_LENGTH = "draws its samples by path length, which is not what a plan among moving agents costs; `rrt-star` is by cost"
_UNBOUND = "OMPL 2.0.1 does not offer it to Python"
_ABSTRACT = "OMPL 2.0.1 gives it no constructor in Python"

_MEMORYLESS = "knows neither speed nor the risk so far; `rrt` carries the total, `{}` caps every step"

# name: reason
REFUSED = {
    "bit-star": _BACKWARD,
    "bfmt": _BACKWARD,
    "informed-rrt-star": _LENGTH,
    "sorrt-star": _LENGTH,
    "rrt-connect": _MEMORYLESS.format("rrt-connect-capped"),
    "fmt": _MEMORYLESS.format("fmt-capped"),
    "kpiece": _MEMORYLESS.format("rrt-connect-capped"),
    "aorrtc": _GOAL_TREE,
    "bkpiece": _GOAL_TREE,
    "lbkpiece": _GOAL_TREE,
    "prm-star": _SYMMETRIC,
    "lazy-prm": _UNBOUND + "; `prm-lazy` does what it does, over time",
    "spars": _UNBOUND,
    "strrt-star": _UNBOUND,
    "trrt": _UNBOUND,
    "sst": _ABSTRACT,
    "pdst": _ABSTRACT,
    "syclop": "OMPL 2.0.1 cannot call its Python parts",
}
