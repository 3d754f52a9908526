"""Swap the backend, keep everything else: one roadmap, one bound, one parked car somebody may pull out with.

The looser a backend's bound on the same risk, the wider the berth it plans, up to no plan at all.
"""

import numpy as np

import riskplan as rp

TIMES = np.arange(0.0, 8.01, 0.1)
BOUND = 0.04
CAR = {"name": "parked", "length": 4.5, "width": 1.8, "headings": np.zeros((len(TIMES), 1))}
BACKENDS = {
    "exact": rp.checker("exact"),
    "projected-sos, order 8": rp.checker("projected-sos", order=8),
    "projected-sos, order 4": rp.checker("projected-sos", order=4),
    "halfspace": rp.checker("halfspace"),
    "chebyshev": rp.checker("chebyshev"),
}


def scene() -> rp.Scenario:
    """Open ground and one uncertain car in the way."""
    out = np.column_stack([np.full_like(TIMES, 30.0), np.clip(0.5 * (TIMES - 2.0), 0.0, 1.0)])
    spread = np.stack([np.diag([0.2, 0.2]) ** 2 for _ in TIMES])[:, None]
    car = rp.GaussianMixturePrediction(TIMES, [1.0], out[:, None], spread, **CAR)
    return rp.Scenario(
        name=f"one bound of {BOUND:g}, five backends",
        start=rp.State(0.0, 0.0, 0.0, 10.0),
        goal=rp.Goal.at(58.0, 0.0, radius=3.0, heading=0.0, heading_tolerance=0.3),
        bounds=(-5.0, -13.0, 65.0, 13.0),
        agents=[car],
        ego=rp.EgoEllipsoid.around(4.5, 1.8, 4.5, 1.8, relative_heading=0.0),
    )


def main() -> None:
    """Plan with each and draw all plans over the true risk."""
    scenario = scene()
    planner = rp.Prm(size=1500, roadmap=rp.Roadmap.build(scenario, size=1500, seed=1))
    figure = rp.plots.risk_map(rp.risk_map(scenario, 3.0, spacing=0.25), scenario)
    axes = figure.axes[0]
    for i, (name, backend) in enumerate(BACKENDS.items()):
        plan = rp.plan(scenario, planner=planner, checker=backend, bound=BOUND, time_limit=2.0, seed=0)
        line = {"color": rp.plots.COLOURS[i], "lw": 7.0 - 1.4 * i, "zorder": 8}  # of one way, all are seen
        if not plan.solved:
            print(f"{name}: {plan.message}")
            axes.plot([], [], label=f"{name}: no plan within the bound", **line)
            continue
        true = rp.audit(plan, scenario, ["exact"], monte_carlo=0).verdicts[0].risk.total
        berth = np.linalg.norm(plan.poses[:, :2] - [30.0, 0.5], axis=1).min()
        print(f"{name}: states {plan.risk.total:.2g}, true {true:.2g}, passes at {berth:.1f} m")
        label = f"{name}: states {plan.risk.total:.2g}, true {f'{true:.0e}' if true > 1e-12 else 'below 1e-12'}"
        axes.plot(*plan.poses[:, :2].T, label=label, **line)
    axes.legend(loc="upper left", fontsize=8, framealpha=0.9)
    axes.set_title(scenario.name, loc="left")
    print("drawn in", rp.plots.save(figure, "out/demos/backends.png"))


if __name__ == "__main__":
    main()
