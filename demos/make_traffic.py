"""Write `riskplan/data/traffic.yaml` and `traffic.npz`, the demo scene whose agents a network predicts.

Two seconds of simulated motorway traffic as observed (`traffic.npz`, in the recorder's format), and the task of one of
its drivers for the next three (`traffic.yaml`, without agents). Run
`riskplan record --out traffic.npz --samples 10000 --seed 0`, then `python demos/make_traffic.py traffic.npz`.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import riskplan as rp
from predictor.datasets.simulator import save_recordings
from riskplan.demo_scene import DATA, with_learned_agents

NOW, HORIZON, REACH = 1.9, 3.0, 70.0


def observed(recording, start, ego):
    """What is known `NOW` s after `start`: tracks near the ego, and without it."""
    now = start + NOW
    there = {t.name: t for t in recording.tracks if t.covers(start, now + HORIZON)}
    here = there[ego].at([now]).positions[0]
    near = [t for t in there.values() if t.name != ego and np.hypot(*(t.at([now]).positions[0] - here)) < REACH]
    return replace(recording, tracks=[t.window(start, now) for t in near], controls={}, focal=(), ego=None)


def task(recording, start, ego):
    """To be where a steady driver would be in 3 s, or up to 10 m less far, in any lane."""
    driver = next(t for t in recording.tracks if t.name == ego).at([start + NOW])
    (x, y), speed = driver.positions[0], driver.speeds[0]
    half = max(float(np.abs(lane.left - lane.centre).max()) for lane in recording.lanes)
    rows = sorted(float(lane.centre[0, 1]) for lane in recording.lanes)
    low, high = rows[0] - half, rows[-1] + half
    box = np.array([[x - 60.0, low], [x + 160.0, low], [x + 160.0, high], [x - 60.0, high]])
    end = x + HORIZON * speed
    finish = np.array([[end - 10.0, low], [end + 20.0, low], [end + 20.0, high], [end - 10.0, high]])
    return rp.Scenario(
        name="motorway, agents as a network predicts them",
        start=rp.State(x, y, float(driver.headings[0]), speed),
        goal=rp.Goal((rp.GoalRegion(finish, heading=0.0, heading_tolerance=0.2),), time=(HORIZON - 0.5, HORIZON)),
        bounds=(x - 20.0, low, x + 130.0, high),
        horizon=HORIZON,
        ego=rp.EgoCover.discs(driver.length, driver.width, 6, relative_heading=0.0),
        vehicle=rp.KinematicCar(length=driver.length, width=driver.width),
        drivable=[box],
        lanes=[np.array([[x - 60.0, row], [x + 160.0, row]]) for row in rows],
    )


def straight_risk(scenario):
    """Stated risk of driving on as before."""
    times = np.arange(31) * 0.1
    start = scenario.start
    poses = np.column_stack([start.x + start.speed * times, np.full(31, start.y), np.zeros(31)])
    return float(rp.path_risk(poses, scenario.agents, scenario.ego, "independent").total)


def candidates(path):
    """Motorway scenes, drivers in them and times, in the order of the file."""
    for recording in rp.open_data(path).recordings():
        if recording.name.startswith("highway"):
            for start in (2.0, 6.0, 10.0):
                for track in recording.tracks:
                    if track.covers(start, start + NOW + HORIZON) and track.at([start + NOW]).speeds[0] > 12.0:
                        yield recording, start, track.name


def main(path):
    """The first task that is dangerous straight on and that both planners solve."""
    for recording, start, ego in candidates(path):
        known, scenario = observed(recording, start, ego), task(recording, start, ego)
        if not 4 <= len(known.tracks) <= 10:
            continue
        whole = with_learned_agents(scenario, known)
        risk = straight_risk(whole)
        if risk < 0.06:  # the bound is 0.05
            continue
        plans = [rp.plan(whole, planner=p, bound=0.05, time_limit=3.0, seed=s) for p in ("rrt", "prm") for s in (0, 1)]
        print(recording.name, start, ego, f"straight on {risk:.2f}", [p.status for p in plans])
        if all(p.solved for p in plans):
            rp.save_scenario(scenario, DATA / "traffic.yaml")
            save_recordings([known], DATA / "traffic.npz")
            return
    raise SystemExit(f"{path}: no scene fits")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
