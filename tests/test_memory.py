"""Planning again and again in one process keeps no memory."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.memory import growth


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads /proc")
@pytest.mark.parametrize("planner", ["rrt", "prm", "rrt-star"])
def test_memory_is_flat(planner):
    solved, sizes = growth(planner, 200, 1500)
    assert solved > 50
    # a leak of 25 kB a plan, the least that OMPL's known ones make, would be 5 MB over 1000 plans
    half = len(sizes) // 2
    assert np.median(sizes[half:]) - np.median(sizes[:half]) < 2.0
