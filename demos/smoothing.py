"""Smooth a plan under its risk bound: scipy's SLSQP with analytic gradients of the trajectory's total risk.

The unknowns are accelerations along and across, so whatever comes out is drivable; the bound is a constraint.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

import riskplan as rp

DT = 0.1


def drive(u, start):
    """(x, y, heading, speed) (…, T, 4) after steps with accelerations u (…, T, 2) along and across: exact arcs."""
    speed = start[3] + DT * np.cumsum(u[..., 0], axis=-1)
    before = np.concatenate([np.broadcast_to(start[3], speed[..., :1].shape), speed[..., :-1]], axis=-1)
    distance = 0.5 * (before + speed) * DT
    turn = distance * u[..., 1] / before**2  # curvature = lateral acceleration / speed²
    heading = start[2] + np.cumsum(turn, axis=-1)
    chord = distance * (1.0 - turn**2 / 24.0 + turn**4 / 1920.0)
    middle = heading - 0.5 * turn
    x, y = start[0] + np.cumsum(chord * np.cos(middle), -1), start[1] + np.cumsum(chord * np.sin(middle), -1)
    return np.stack([x, y, heading, speed], axis=-1)


def with_jacobian(f, u):
    """f(u) and its Jacobian (…, 2T) by complex steps, exact to rounding and all at once."""
    moved = u + 1e-30j * np.eye(u.size).reshape(u.size, *u.shape)
    return f(u), np.moveaxis(f(moved).imag / 1e-30, 0, -1)


def roughness(u):
    """Mean squared jerk along and across [m²/s⁶]."""
    return (np.diff(u, axis=-2) ** 2).sum(axis=(-1, -2)) / DT**2 / u.shape[-2]


def total_risk(states, plan, scenario, checker):
    """Trajectory total and its gradient (T, 3) at the poses driven."""
    poses = np.concatenate([plan.poses[:1], states[:, :3]])
    agents = [a.at(plan.times) for a in scenario.agents]
    risks = [checker(poses, a, scenario.ego) for a in agents]
    changes = [checker.gradient(poses, a, scenario.ego) for a in agents]
    total = float(rp.trajectory_risk(risks, agents).total)
    return total, rp.trajectory_risk_gradient(risks, changes, agents)[1:]


def main() -> None:
    """Plan, smooth, judge again."""
    scenario, bound = rp.load_scenario("riskplan/data/overtake.yaml"), 0.05
    plan = rp.plan(scenario, planner="rrt", checker="exact", bound=bound, time_limit=10.0, seed=0)
    if not plan.solved:
        raise SystemExit(plan.message)
    start = np.append(plan.poses[0], plan.speeds[0])
    curvature = np.diff(np.unwrap(plan.poses[:, 2])) / (0.5 * (plan.speeds[:-1] + plan.speeds[1:]) * DT)
    u0 = np.stack([np.diff(plan.speeds) / DT, curvature * plan.speeds[:-1] ** 2], axis=-1)
    ends, low, high = np.array([*plan.poses[-1], plan.speeds[-1]]), plan.poses[:, 1].min(), plan.poses[:, 1].max()
    checker, car = rp.checker("exact"), scenario.vehicle

    def risk_left(v):
        return np.log(0.98 * bound) - np.log(total_risk(drive(v.reshape(-1, 2), start), plan, scenario, checker)[0])

    def risk_left_gradient(v):
        states, jacobian = with_jacobian(lambda u: drive(u, start), v.reshape(-1, 2))
        total, change = total_risk(states, plan, scenario, checker)
        return -np.einsum("ti,tin->n", change, jacobian[:, :3]) / total

    def of_states(g):
        return {
            "fun": lambda v: g(drive(v.reshape(-1, 2), start)),
            "jac": lambda v: with_jacobian(lambda u: g(drive(u, start)), v.reshape(-1, 2))[1],
        }

    found = minimize(
        lambda v: roughness(v.reshape(-1, 2)),
        u0.ravel(),
        jac=lambda v: with_jacobian(roughness, v.reshape(-1, 2))[1],
        method="SLSQP",
        bounds=[(-car.max_deceleration, car.max_acceleration), (-4.5, 4.5)] * len(u0),
        constraints=[
            {"type": "ineq", "fun": risk_left, "jac": risk_left_gradient},
            {"type": "eq", **of_states(lambda s: s[..., -1, :] - ends)},
            {"type": "ineq", **of_states(lambda s: s[..., 1] - low)},
            {"type": "ineq", **of_states(lambda s: high - s[..., 1])},
        ],
        options={"maxiter": 30},
    )
    states = np.vstack([start, drive(found.x.reshape(-1, 2), start)])
    smooth = replace(plan, poses=states[:, :3], speeds=states[:, 3])
    judged = float(rp.audit(smooth, scenario, ["exact"], monte_carlo=0).verdicts[0].risk.total)
    free = all(scenario.world.free(*pose) for pose in smooth.poses)
    print(f"roughness {roughness(u0):.3g} -> {found.fun:.3g} m²/s⁶ in {found.nit} iterations")
    print(f"risk {plan.risk.total:.4f} -> {judged:.4f}, bound {bound}: within {judged <= bound}, drivable {free}")


if __name__ == "__main__":
    main()
