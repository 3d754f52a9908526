"""Can a vehicle drive this? Equations of motion, integrated by scipy, against what the compiled motions say.

Between two states on the grid controls are looked for that lead from one to the other within every limit; the
equations are then integrated finely under these controls and must end in the second state. Where a roadmap's curve
changes its curvature within a step, several arcs are tried.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from riskplan.vehicles.kinematic_bicycle import KinematicBicycle
from riskplan.vehicles.point_robot import PointRobot

G = 9.80665


def assert_drivable(vehicle, states, dt):
    """states (T, 5): x, y, heading, speed, steering."""
    check = {KinematicBicycle: _bicycle_step, PointRobot: _point_step}.get(type(vehicle), _car_step)
    for i in range(len(states) - 1):
        try:
            check(vehicle, states[i], states[i + 1], dt)
        except AssertionError as error:
            raise AssertionError(f"step {i}: {states[i]} -> {states[i + 1]}: {error}") from error


def states_of(plan):
    return np.column_stack([plan.poses, plan.speeds, plan.steering])


def wrapped(angle):
    return float(np.angle(np.exp(1j * angle)))


def _pose_close(found, wanted):
    np.testing.assert_allclose(found[:2], wanted[:2], atol=5e-6, rtol=0)
    assert abs(wrapped(found[2] - wanted[2])) < 5e-6


# cars: x' = v cos h, y' = v sin h, h' = κ v, v' = a


def _car_step(car, s0, s1, dt):
    low = -getattr(car, "max_reverse_speed", 0.0)
    assert low - 1e-9 <= s1[3] <= max(car.max_speed, s0[3]) + 1e-9
    # constant acceleration, or what the chord of one arc says; any that the limits allow for will do
    profiles = [[(dt, (s1[3] - s0[3]) / dt, s0[3])], _profile(s0, s1, dt)]
    failures = []
    for profile in profiles:
        try:
            return _car_drives(car, s0, s1, profile)
        except AssertionError as error:
            failures.append(error)
    raise failures[-1]


def _car_drives(car, s0, s1, profile):
    for duration, a, v in profile:
        ends = np.array([v, v + a * duration])
        faster = abs(ends[1]) > abs(ends[0])
        assert abs(a) <= (car.max_acceleration if faster else car.max_deceleration) + 1e-6
        assert ends[0] * ends[1] >= -1e-12  # never through zero within a step
    arcs = _arcs(s0, s1, _distance(profile), car.max_curvature)
    assert max(abs(k) for _, k in arcs) <= car.max_curvature + 1e-6
    fastest = max(abs(s0[3]), abs(s1[3]))
    for length, k in arcs:
        if abs(length) > 1e-6:
            assert abs(k) * fastest**2 <= car.max_lateral_acceleration * 1.01 + 1e-6
    _pose_close(_drive_arcs(s0, arcs, profile), s1)


def _profile(s0, s1, dt):
    """(duration, acceleration, speed at its begin): constant, or a ramp to the final speed and then held."""
    v0, v1 = s0[3], s1[3]
    chord = np.hypot(*(s1[:2] - s0[:2]))
    half = 0.5 * wrapped(s1[2] - s0[2])
    way = chord / max(np.sinc(half / np.pi), 0.1) * np.sign(v0 + v1)
    mean = 0.5 * (v0 + v1) * dt
    if abs(v1 - v0) < 1e-12 or abs(way - mean) < 1e-5 * max(abs(mean), 1e-3):
        return [(dt, (v1 - v0) / dt, v0)]
    # way = ½ (v0 + v1) t + v1 (dt − t)
    t = (way - v1 * dt) / (0.5 * (v0 - v1))
    if 0 < t < dt:
        return [(t, (v1 - v0) / t, v0), (dt - t, 0.0, v1)]
    return [(dt, (v1 - v0) / dt, v0)]  # several arcs within the step: the chord says little


def _distance(profile):
    return sum((v + 0.5 * a * t) * t for t, a, v in profile)


def _arcs(s0, s1, distance, most):
    turn = wrapped(s1[2] - s0[2])
    if abs(distance) < 1e-9:
        return [(distance, 0.0)]
    one = [(distance, turn / distance)]
    if np.hypot(*(_end(s0, one)[:2] - s1[:2])) < 1e-6:
        return one
    best = None
    for start in ([0.5, 0.0, 0.0], [0.3, most, 0.0], [0.7, 0.0, most], [0.3, -most, 0.0], [0.7, 0.0, -most]):

        def off(p):
            end = _end(s0, [(p[0] * distance, p[1]), ((1 - p[0]) * distance, p[2])])
            return [*(end[:2] - s1[:2]), wrapped(end[2] - s1[2])]

        bounds = ([0, -most - 1e-7, -most - 1e-7], [1, most + 1e-7, most + 1e-7])
        found = least_squares(off, start, bounds=bounds, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if best is None or found.cost < best.cost:
            best = found
        if best.cost < 1e-14:
            break
    share, first, second = best.x
    return [(share * distance, first), ((1 - share) * distance, second)]


def _end(s0, arcs):
    x, y, h = s0[:3]
    for length, k in arcs:
        # ∫ of the heading's direction along an arc, in closed form
        z = (
            length * np.exp(1j * h)
            if abs(k * length) < 1e-9
            else np.exp(1j * h) * (np.exp(1j * k * length) - 1) / (1j * k)
        )
        x, y, h = x + z.real, y + z.imag, h + k * length
    return np.array([x, y, h])


def _drive_arcs(s0, arcs, profile):
    """Integrate the equations; curvature is a function of the way driven."""
    edges = np.cumsum([abs(length) for length, _ in arcs])

    def rates(_t, z, a):
        k = arcs[min(int(np.searchsorted(edges, z[4] + 1e-12)), len(arcs) - 1)][1]
        return [z[3] * np.cos(z[2]), z[3] * np.sin(z[2]), k * z[3], a, abs(z[3])]

    z = np.array([*s0[:4], 0.0])
    for duration, a, _ in profile:
        z = solve_ivp(rates, (0, duration), z, args=(a,), rtol=1e-9, atol=1e-10, max_step=duration / 10).y[:, -1]
    return z


# bicycle about its centre; friction from the numerical derivative of the velocity vector


def _bicycle_rates(car, a, rate):
    def rates(_t, z):
        beta = np.arctan2(car.rear * np.sin(z[4]), car.wheelbase * np.cos(z[4]))
        # the rear axle does not slip: its velocity is along the body, and the body turns about it
        return [
            z[3] * np.cos(z[2] + beta),
            z[3] * np.sin(z[2] + beta),
            z[3] * np.sin(beta) / car.rear,
            a,
            rate,
        ]

    return rates


def _bicycle_step(car, s0, s1, dt):
    a, rate = (s1[3] - s0[3]) / dt, (s1[4] - s0[4]) / dt
    assert -car.max_deceleration - 1e-6 <= a <= car.max_acceleration + 1e-6
    assert abs(rate) <= car.max_steering_rate + 1e-6
    assert abs(s1[4]) <= car.max_steering + 1e-9
    assert -1e-9 <= s1[3] <= max(car.max_speed, s0[3]) + 1e-9
    rates = _bicycle_rates(car, a, rate)
    run = solve_ivp(rates, (0, dt), s0, rtol=1e-11, atol=1e-11, dense_output=True)
    _pose_close(run.y[:, -1], s1)
    h = 1e-4
    for t in np.linspace(h, dt - h, 21):
        ahead, behind = (np.array(rates(0, run.sol(t + sign * h))[:2]) for sign in (1, -1))
        pull = np.hypot(*(ahead - behind)) / (2 * h)
        assert pull <= car.friction * G * (1 + 1e-4), (pull, t)


# point robot: x'' = a, or an arc of a roadmap


def _point_step(robot, s0, s1, dt):
    assert s1[3] <= max(robot.max_speed, s0[3]) + 1e-9
    v0, v1 = (s[3] * np.array([np.cos(s[2]), np.sin(s[2])]) for s in (s0, s1))
    straight = s0[:2] + 0.5 * (v0 + v1) * dt
    if np.hypot(*(straight - s1[:2])) < 1e-8:
        a = (v1 - v0) / dt
        assert np.hypot(*a) <= robot.max_acceleration + 1e-6
        run = solve_ivp(lambda _t, z: [z[2], z[3], *a], (0, dt), [*s0[:2], *v0], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(run.y[:2, -1], s1[:2], atol=1e-7)
        return
    a = (s1[3] - s0[3]) / dt
    profile = [(dt, a, s0[3])]
    arcs = _arcs(s0, s1, _distance(profile), 2.0 / robot.radius)
    fastest = max(s0[3], s1[3])
    for length, k in arcs:
        if abs(length) > 1e-6:
            assert np.hypot(a, k * fastest**2) <= robot.max_acceleration * 1.01 + 1e-6
    _pose_close(_drive_arcs(s0, arcs, profile), s1)
