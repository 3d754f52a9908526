"""Plan past a pedestrian who may step onto the road, check the plan by sampling, and draw it."""

import numpy as np

import riskplan as rp

times = np.arange(0.0, 5.01, 0.1)
stays, crosses = np.zeros((2, len(times), 2))
stays[:] = [24.0, 4.0]
crosses[:, 0], crosses[:, 1] = 24.0, 4.0 - 1.2 * times
spread = (0.2 + 0.1 * times) ** 2

pedestrian = rp.GaussianMixturePrediction(
    times,
    weights=[0.7, 0.3],
    means=np.stack([stays, crosses], axis=1),  # (T, K, 2)
    covariances=spread[:, None, None, None] * np.eye(2) * np.ones((1, 2, 1, 1)),  # (T, K, 2, 2)
    name="pedestrian",
    length=0.5,
    width=0.5,
)
scenario = rp.Scenario(
    name="a pedestrian who may cross",
    start=rp.State(0.0, 0.0, 0.0, 8.0),
    goal=rp.Goal.at(36.0, 0.0, radius=6.0, time=(3.0, 5.0)),
    bounds=(-5.0, -4.0, 60.0, 4.0),
    agents=[pedestrian],
    ego=rp.EgoCover.discs(4.5, 1.8, n=6),
)
plan = rp.plan(scenario, planner="rrt", checker="exact", bound=0.01, time_limit=5.0, seed=0)
print(plan.message)
if plan.solved:
    report = rp.audit(plan, scenario, checkers=["exact", "sos"], monte_carlo=20_000)
    for verdict in report.verdicts:
        print(f"{verdict.checker}: {verdict.kind}, total {verdict.risk.total:.3g}")
    print(f"sampled: {report.sampled.total:.3g}, 99 % interval {report.sampled.interval}")
    print("drawn in", rp.render(scenario, plan, "quickstart.html"))
