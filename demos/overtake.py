"""Overtake among cars of three modes each within a risk bound, and draw it: a page, a 3-D still, a top view, plots."""

import numpy as np

import riskplan as rp

FOLDER = "out/demos"


def main() -> None:
    """Plan the shipped scene and draw what came out."""
    scenario = rp.load_scenario("riskplan/data/overtake.yaml")
    plan = rp.plan(scenario, planner="rrt", checker="exact", bound=0.05, time_limit=10.0, seed=0)
    print(plan.message)
    middle = 2.2  # what map and top view show [s]
    rp.render(scenario, plan, f"{FOLDER}/overtake.html", samples=50)
    rp.render(scenario, plan, f"{FOLDER}/overtake.png", time=0.8, size=(1280, 640))
    rp.render(scenario, plan, f"{FOLDER}/overtake-top.png", time=middle, view="top")
    found = rp.risk_map(scenario, middle, spacing=0.25, window=(-10.0, -1.75, 90.0, 8.75))
    rp.plots.save(rp.plots.risk_map(found, scenario, plan), f"{FOLDER}/overtake-map.png")
    backends = ["exact", "projected-sos", "sos", "halfspace"]
    rp.plots.save(rp.plots.risk_over_time(scenario, plan, backends, seed=0), f"{FOLDER}/overtake-risk.png")
    here = np.interp(middle, plan.times, plan.risk.per_step)
    print(f"risk of the step at {middle} s: {here:.2g}; pictures in {FOLDER}")


if __name__ == "__main__":
    main()
