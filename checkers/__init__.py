"""Collision primitives: the probability that a predicted agent enters the ego's shape at a pose.

The value types are imported at once; the backends, which need numba, on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
