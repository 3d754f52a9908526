"""Agents known by their controls: moments through the nonlinear motion, a plan within an SOS bound, no Gaussian.

The dots are simulated futures: bent like a banana, which no Gaussian is. The ellipses are the covariance alone.
"""

import riskplan as rp

STEPS, DT = 50, 0.1


def car(name: str, where: dict, weights: list[float]) -> rp.ControlPrediction:
    """A car that keeps to its course or swerves; speed and turn rate are uncertain at each step."""
    keeps = {"w_v": rp.Normal(0.0, 0.05), "w_theta": rp.Normal(0.0, 0.012)}
    swerves = {"w_v": rp.Uniform(-0.10, 0.0), "w_theta": rp.Normal(0.012, 0.012)}
    return rp.ControlPrediction(
        rp.dynamics.dubins(DT), where, [keeps, swerves], steps=STEPS, weights=weights, name=name, length=4.5, width=1.8
    )


def main() -> None:
    """Plan among two of them with a moment bound; ask other backends and simulation; draw."""
    uncertain = {"theta": rp.Normal(0.0, 0.05)}
    scenario = rp.Scenario(
        name="controls predicted, SOS bound",
        start=rp.State(0.0, 0.0, 0.0, 11.0),
        goal=rp.Goal.at(52.0, -6.0, radius=6.0, time=(3.0, 5.0)),
        bounds=(-8.0, -22.0, 70.0, 16.0),
        agents=[
            car("ahead", {"x": 20.0, "y": 2.0, "v": 8.0, **uncertain}, [0.8, 0.2]),
            car("aside", {"x": 6.0, "y": 9.0, "v": 10.0, **uncertain}, [0.9, 0.1]),
        ],
        ego=rp.EgoEllipsoid.around(4.5, 1.8, 4.5, 1.8),
    )
    backend = rp.checker("projected-sos", order=4)
    plan = rp.plan(scenario, planner="rrt", checker=backend, bound=0.2, time_limit=8.0, seed=0)
    print(plan.message)
    if plan.solved:
        report = rp.audit(plan, scenario, ["projected-sos", "halfspace", "chebyshev"], monte_carlo=20_000)
        for verdict in report.verdicts:
            print(f"{verdict.checker}: {verdict.kind} {verdict.risk.total:.3g}")
        print(f"simulated futures that collide: {report.sampled.total:.2g}, interval {report.sampled.interval}")
    rp.render(scenario, plan, "out/demos/controls.html", density=150)
    rp.render(scenario, plan, "out/demos/controls.png", time=2.0, density=400, view="top", size=(1200, 660))


if __name__ == "__main__":
    main()
