"""Motion planning under a stated bound on collision risk; `import riskplan as rp` reaches everything public.

Heavy parts (numba, OMPL, meshcat, torch) are imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
