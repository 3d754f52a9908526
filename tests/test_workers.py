"""Several processes, one seed each: the same answers as alone, nothing left behind, also after Ctrl-C."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import riskplan as rp
from tests.scenes import overtake


def test_the_lowest_seed_wins_and_equals_its_own_search():
    scene = overtake()
    asked = {"bound": 0.05, "time_limit": 60.0, "iterations": 3000}
    alone = [rp.plan(scene, seed=seed, **asked) for seed in (3, 4)]
    expected = next(plan for plan in alone if plan.solved)
    both = rp.plan(scene, seed=3, workers=2, **asked)
    np.testing.assert_array_equal(both.poses, expected.poses)
    assert both.settings["seed"] == expected.settings["seed"] and both.settings["workers"] == 2
    assert not multiprocessing.active_children()


def test_the_best_is_taken_without_a_bound():
    scene = overtake()
    asked = {"bound": None, "time_limit": 60.0, "iterations": 400}
    alone = [rp.plan(scene, seed=seed, **asked) for seed in (0, 1)]
    both = rp.plan(scene, seed=0, workers=2, **asked)
    assert both.stats["answers"] == 2
    assert float(both.risk.total) == min(float(p.risk.total) for p in alone if p.solved)


def test_what_a_search_refuses_its_workers_refuse():
    scene = overtake()
    with pytest.raises(rp.InputError, match="exact: needs a Gaussian mixture"):
        rp.plan(scene.with_agents([a.moments(4) for a in scene.agents]), workers=2)
    with pytest.raises(rp.InputError, match="workers: expected an integer >= 1 and <= 256, got 0"):
        rp.plan(scene, workers=0)
    assert not multiprocessing.active_children()


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_ctrl_c_ends_all(tmp_path):
    scenario = "riskplan/data/overtake.yaml"
    command = [sys.executable, "-m", "riskplan", "plan", scenario, "--bound", "1e-12", "--time-limit", "60"]
    process = subprocess.Popen([*command, "--workers", "2"], start_new_session=True, stderr=subprocess.PIPE)
    try:
        deadline = time.monotonic() + 40.0
        while time.monotonic() < deadline and len(members(process.pid)) < 3:
            time.sleep(0.2)
        assert len(members(process.pid)) >= 3
        time.sleep(1.0)
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(timeout=20.0) == 130
        deadline = time.monotonic() + 10.0  # multiprocessing's own resource tracker takes its leave
        while members(process.pid) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert not members(process.pid)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def members(session):
    """Living processes of a session."""
    found = []
    for entry in os.listdir("/proc") if os.path.isdir("/proc") else []:
        if entry.isdigit():
            try:
                fields = Path(f"/proc/{entry}/stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[3]) == session and fields[0] != "Z":
                found.append(int(entry))
    return found
