"""Agents known by their controls: mixtures, times, files, and their place in checkers, scenarios, plans and audits."""

import json
from dataclasses import replace

import numpy as np
import pytest

import riskplan as rp
from checkers.backends.monte_carlo import clopper_pearson
from checkers.control_input import StepMixture

N = rp.Normal
DUBINS = rp.dynamics.dubins(0.1)
START = {"x": 25.0, "y": 0.5, "v": 7.0, "theta": N(0.0, 0.02)}
KEEP = {"w_v": N(0.0, 0.05), "w_theta": N(0.0, 0.005)}
BRAKE = {"w_v": N(-0.1, 0.1), "w_theta": rp.Uniform(-0.002, 0.01)}


def car(steps=30, **labels):
    return rp.ControlPrediction(
        DUBINS,
        START,
        [KEEP, BRAKE],
        steps,
        weights=[0.7, 0.3],
        **{"name": "car", "length": 4.5, "width": 1.8, **labels},
    )


def scenario(agent):
    return rp.Scenario(
        start=rp.State(0, 0, 0, 8),
        goal=rp.Goal.at(22, 3, radius=4, time=(2, 3)),
        bounds=(-10, -10, 60, 10),
        agents=[agent],
        ego=rp.EgoCover.discs(4.5, 1.8, relative_heading=0.0),
    )


def test_modes_are_propagated_each_for_itself():
    both = car().moments(4)
    for k, controls in enumerate((KEEP, BRAKE)):
        alone = rp.propagate(DUBINS, START, controls, 30, order=4)
        assert np.allclose(both.means[:, k], alone.means[:, 0], rtol=1e-14)
        assert np.allclose(both.central_moments[:, k], alone.central_moments[:, 0], rtol=1e-12, equal_nan=True)
    assert both.times[[0, 1, -1]].tolist() == [0.0, 0.1, 3.0]
    assert (both.name, both.length, both.width) == ("car", 4.5, 1.8)


@pytest.mark.parametrize("modes", ["persistent", "per_step"])
def test_samples_follow_the_moments(modes):
    agent = rp.ControlPrediction(DUBINS, START, [KEEP, BRAKE], 10, weights=[0.7, 0.3], modes=modes)
    pred, n = agent.moments(4), 200_000
    paths = agent.sample(n, np.random.default_rng(2))
    assert pred.means.shape[1] == (2 if modes == "persistent" else 1)
    for t in (3, 10):
        for i, j in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (2, 1), (4, 0), (2, 2), (0, 4)):
            centre = pred.weights @ pred.means[t]
            z = (paths[:, t, 0] - centre[0]) ** i * (paths[:, t, 1] - centre[1]) ** j
            d = pred.means[t] - centre
            expected = sum(
                w * shifted(pred.central_moments[t, k], d[k], i, j) for k, w in enumerate(pred.weights.tolist())
            )
            assert abs(z.mean() - expected) <= 4 * z.std() / np.sqrt(n)


def shifted(moments, d, i, j):
    """E[(δx + d₁)^i (δy + d₂)^j]."""
    px = np.polynomial.polynomial.polypow([d[0], 1.0], i)
    py = np.polynomial.polynomial.polypow([d[1], 1.0], j)
    return sum(px[a] * py[b] * moments[a, b] for a in range(i + 1) for b in range(j + 1))


def test_a_step_mixture_draws_its_noises_together():
    # left and slower, or right and faster: the noises are dependent through the component
    parts = [{"w_v": -1.0, "w_theta": 0.3}, {"w_v": 1.0, "w_theta": -0.3}]
    agent = rp.ControlPrediction(DUBINS, [0, 0, 5, 0], parts, 2, weights=[0.5, 0.5], modes="per_step")
    ends = np.array([[0.5 + 0.1 * v * np.cos(th), 0.1 * v * np.sin(th)] for v, th in ((4.0, 0.3), (6.0, -0.3))])
    pred = agent.moments(2)
    assert np.allclose(pred.means[-1, 0], ends.mean(axis=0), rtol=1e-14)
    assert np.allclose(pred.covariances[-1, 0], np.cov(ends.T, bias=True), rtol=1e-12)


def test_step_mixtures_may_differ_between_modes_and_steps():
    weights = np.column_stack([np.linspace(0, 1, 4), np.linspace(1, 0, 4)])
    names = ("w_v", "w_theta")
    part = [{w: m[w] for w in names} for m in (KEEP, BRAKE)]
    mixed = StepMixture(weights, tuple(part))
    agent = rp.ControlPrediction(DUBINS, START, [mixed, KEEP], 4, weights=[0.5, 0.5])
    alone = rp.propagate(DUBINS, START, KEEP, 4, order=2)
    assert np.allclose(agent.moments(2).covariances[:, 1], alone.covariances[:, 0], rtol=1e-12)
    switched = rp.propagate(DUBINS, START, BRAKE, 4, order=2)
    assert np.allclose(agent.moments(2).means[1, 0], switched.means[1, 0], rtol=1e-14)
    assert replace(agent, name="again").moments(2).covariances == pytest.approx(agent.covariances)


def test_controls_may_change_from_step_to_step():
    turns = [N(0.1 * t, 0.01) for t in range(5)]
    agent = rp.propagate(DUBINS, START, {"w_v": 0.0, "w_theta": turns}, 5, order=2)
    heading = np.cumsum([0.0, *(x.mean for x in turns[:4])])
    straight = np.cumsum(0.7 * np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0)
    assert np.abs(agent.means[1:, 0] - [25.0, 0.5] - straight).max() < 0.01


def test_at_keeps_steps_and_refuses_others():
    agent = car()
    part = agent.at([0.5, 1.0, 2.0])
    assert np.array_equal(part.means, agent.means[[5, 10, 20]])
    assert part.sample(3, np.random.default_rng(0)).shape == (3, 3, 2)
    assert agent.at(agent.times) is agent
    assert np.array_equal(agent.at([0.0]).means, agent.means[:1])
    with pytest.raises(rp.InputError) as error:
        agent.at([0.5, 1.05])
    assert str(error.value) == "times[1]: car is known at its own steps of 0.1 s from 0 to 3 s, got 1.05"


def test_equal_seeds_sample_equal_futures():
    one, two = (car().sample(50, np.random.default_rng(7)) for _ in range(2))
    assert np.array_equal(one, two)


def test_files_bring_it_back_bit_for_bit(tmp_path):
    start = {("x", "y", "v"): rp.JointNormal([25.0, 0.5, 7.0], np.diag([0.1, 0.2, 0.3])), "theta": rp.Beta(2, 3, -1, 1)}
    parts = [
        {
            "w_v": [rp.Mixture([0.5, 0.5], (N(0.0, 0.1), 0.3)), rp.Gamma(2, 0.1)] * 2,
            "w_theta": rp.Triangular(0, 0, 0.1),
        },
        {"w_v": rp.Discrete([0, 1], [0.5, 0.5]), "w_theta": rp.Exponential(0.1)},
    ]
    step_mixture = rp.ControlPrediction(DUBINS, start, parts, 4, weights=[0.2, 0.8], modes="per_step")
    for agent in (rp.ControlPrediction(DUBINS, start, parts, 4, weights=[0.2, 0.8], name="a"), step_mixture):
        for kept in (agent, agent.at([0.1, 0.3])):
            kept.save(tmp_path / "a.npz")
            again = rp.load_prediction(tmp_path / "a.npz")
            assert isinstance(again, rp.ControlPrediction)
            assert (again.name, again.system) == (kept.name, kept.system)
            assert np.array_equal(again.times, kept.times)
            got, expected = again.moments(4).central_moments, kept.moments(4).central_moments
            assert np.array_equal(got, expected, equal_nan=True)
            one, two = (p.sample(20, np.random.default_rng(1)) for p in (kept, again))
            assert np.array_equal(one, two)


def test_scenario_files_bring_it_back_bit_for_bit(tmp_path):
    world = scenario(car())
    rp.save_scenario(world, tmp_path / "s.yaml")
    again = rp.load_scenario(tmp_path / "s.yaml").agents[0]
    assert np.array_equal(again.moments(4).central_moments, car().moments(4).central_moments, equal_nan=True)
    assert (again.name, again.length, again.width) == ("car", 4.5, 1.8)


YAML = """
version: 1
start: {{x: 0, y: 0, heading: 0}}
goal: {{regions: [{{circle: {{x: 5, y: 0, radius: 2}}}}]}}
bounds: [-10, -10, 60, 10]
agents:
  - name: car
    controls:
      system: {system}
      steps: 20
      initial: {initial}
      controls: {controls}
"""
PARTS = {
    "system": "{shipped: unicycle, dt: 0.1}",
    "initial": "{x: 20, y: 0, theta: {normal: {mu: 0, sd: 0.01}}}",
    "controls": "[{w_speed: {normal: {mu: 8, sd: 0.5}}, w_turn: 0}]",
}


def test_a_short_file_says_enough(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(YAML.format(**PARTS))
    agent = rp.load_scenario(path).agents[0]
    assert np.allclose(agent.means[-1, 0], [36.0, 0.0], atol=0.01)


@pytest.mark.parametrize(
    ("part", "text", "message"),
    [
        ("system", "{shipped: bicycle, dt: 0.1}", "system.shipped: expected one of dubins, dubins_lateral, unicycle, "),
        ("system", "{shipped: dubins}", "system: dt is missing; expected shipped, dt"),
        (
            "system",
            "{updates: {x: x}, noise: [], dt: 1}",
            "system: unknown key 'noise'; expected one of updates, noises, ",
        ),
        ("initial", "{x: 20, y: 0}", "initial: 'theta' is missing; expected x, y, theta"),
        ("initial", "{x: {norm: {mu: 0}}, y: 0, theta: 0}", "initial['x']: expected one of normal, uniform, beta, "),
        ("initial", "{x: {normal: {mu: 0}}, y: 0, theta: 0}", "initial['x'].normal: sd is missing; expected mu, sd"),
        ("initial", "{x: {normal: {mu: 0, sd: -1}}, y: 0, theta: 0}", "initial['x']: Normal: sd: expected a finite"),
        ("controls", "[{w_speed: 8}]", "controls[0]: 'w_turn' is missing; expected w_speed, w_turn"),
        (
            "controls",
            "[{w_speed: [8, 9], w_turn: 0}]",
            "controls[0]['w_speed']: expected one for each of 20 steps, got 2",
        ),
        ("controls", "[{w_speed: fast, w_turn: 0}]", "controls[0]['w_speed']: expected a number or one of normal, "),
    ],
)
def test_files_that_are_wrong_say_where(tmp_path, part, text, message):
    path = tmp_path / "s.yaml"
    path.write_text(YAML.format(**{**PARTS, part: text}))
    with pytest.raises(rp.InputError) as error:
        rp.load_scenario(path)
    assert str(error.value).startswith(f"{path}: agents[0] (car): {message}")
    assert "\n" not in str(error.value)


def test_headings_of_an_agent_known_by_its_controls_are_refused(tmp_path):
    car().save(tmp_path / "car.npz")
    head = YAML.split("    controls:")[0]
    for text in (
        YAML.format(**PARTS) + "    headings: [[0]]\n",
        head.format() + "    headings: [[0]]\n    file: car.npz\n",
    ):
        (tmp_path / "s.yaml").write_text(text)
        with pytest.raises(rp.InputError, match="headings: expected none for an agent known by its controls"):
            rp.load_scenario(tmp_path / "s.yaml")


def test_a_corrupt_document_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    for text in ("{", json.dumps({"system": {}}), "[" * 100_000):
        np.savez(path, type=np.asarray("controls"), document=np.asarray(text))
        with pytest.raises(rp.InputError, match=r"document: expected JSON|controls: steps is missing"):
            rp.load_prediction(path)


@pytest.mark.parametrize("name", ["chebyshev", "halfspace", "marshall-olkin", "sos", "projected-sos"])
def test_checkers_take_it_as_its_moments(name):
    agent, poses = car(), np.zeros((31, 3))
    poses[:, 0] = 6.0 * np.arange(31) * 0.1
    checker = rp.checker(name)
    ego = rp.EgoEllipsoid.around(4.5, 1.8)
    one, two = checker(poses, agent, ego), checker(poses, agent.moments(max(checker.moments_needed, 2)), ego)
    assert np.array_equal(one.value, two.value)
    assert rp.trajectory_risk([one], [agent]).total == rp.trajectory_risk([two], [agent.moments(2)]).total


def test_gaussian_backends_say_what_they_need():
    with pytest.raises(rp.InputError, match="exact: needs a Gaussian mixture, but car is known by its moments only"):
        rp.checker("exact")(np.zeros((31, 3)), car(), rp.EgoEllipsoid.around(4.5, 1.8))


def test_it_is_planned_around_audited_and_drawn(tmp_path):
    world = scenario(car())
    plan = rp.plan(world, checker="projected-sos", bound=0.2, time_limit=10.0, seed=1)
    assert plan.solved
    report = rp.audit(plan, world, checkers=["projected-sos", "chebyshev"], monte_carlo=20_000)
    assert report.verdicts[0].risk.total == pytest.approx(plan.risk.total, rel=1e-9)
    assert report.consistent
    assert report.sampled.complete
    assert 0 <= report.sampled.total <= plan.risk.total
    rp.render(world, plan, tmp_path / "scene.png")
    assert (tmp_path / "scene.png").stat().st_size > 1000


def test_a_grid_that_misses_its_steps_is_refused():
    agent = rp.ControlPrediction(rp.dynamics.dubins(0.15), START, KEEP, 20)
    with pytest.raises(rp.InputError) as error:
        scenario(agent)
    known = "the prediction is known at its own steps of 0.15 s from 0 to 3 s, got 0.1"
    assert str(error.value) == f"time_step 0.1 s: agents[0].times[1]: {known}"


def test_stated_risk_is_not_below_the_sampled_one_nor_zero():
    poses = np.zeros((31, 3))
    poses[:, 0] = np.linspace(0.0, 26.0, 31)
    assert_bounds_hold(car(), poses, 100_000, np.random.default_rng(3), confidence=0.9999)


def assert_bounds_hold(agent, poses, n, rng, confidence):
    """Every moment backend at every step, mode by mode, against simulated futures; returns how many steps collided."""
    ego = rp.EgoEllipsoid.around(4.5, 1.8, 4.5, 1.8, relative_heading=0.0)
    bounds = [rp.checker(name)(poses, agent, ego) for name in ("chebyshev", "halfspace", "sos", "projected-sos")]
    hits = np.zeros(len(poses))
    for _ in range(n // 50_000):
        paths = agent.sample(50_000, rng)
        for t, (x, y, heading) in enumerate(poses):
            c, s = np.cos(heading), np.sin(heading)
            body = (paths[:, t] - [x, y]) @ np.array([[c, -s], [s, c]])
            hits[t] += np.count_nonzero(np.einsum("ni,ij,nj->n", body, ego.Q, body) <= 1.0)
    low, _ = clopper_pearson(hits, n // 50_000 * 50_000, confidence)
    for bound in bounds:
        assert (bound.value @ agent.weights >= low).all()
    return int(np.count_nonzero(hits))


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_bounds_hold_in_two_hundred_random_scenarios(part):
    collided = 0
    for seed in range(50 * part, 50 * part + 50):
        rng = np.random.default_rng(seed)
        steps = 10
        modes = [
            {
                "w_v": rp.Uniform(-a, a) if rng.random() < 0.5 else N(rng.uniform(-0.5, 0.5), a),
                "w_theta": N(rng.uniform(-0.1, 0.1), b) if rng.random() < 0.5 else rp.Beta(2.0, 3.0, -b, 2 * b),
            }
            for a, b in rng.uniform([0.01, 0.001], [1.0, 0.2], (2, 2))
        ]
        start = {"x": 0, "y": 0, "v": N(8.0, rng.uniform(0, 1)), "theta": N(rng.uniform(-3, 3), 0.05)}
        w = rng.uniform(0.1, 0.9)
        agent = rp.ControlPrediction(rp.dynamics.dubins(0.3), start, modes, steps, weights=[w, 1 - w])
        mean = agent.weights @ agent.means
        offset = rng.normal(0, 1, 2) * rng.uniform(0, 8)
        poses = np.column_stack([mean + offset, np.full(steps + 1, rng.uniform(-3, 3))])
        collided += assert_bounds_hold(agent, poses, 1_000_000, rng, confidence=1 - 1e-7)
    assert collided > 100  # the bounds were put to the test


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"system": "dubins"}, "system: expected a System, got str"),
        ({"steps": 0}, "steps: expected an integer from 1 to 100000, got 0"),
        ({"initial": [0, 0]}, "initial: expected a mapping or a value for each of x, y, v, theta"),
        ({"initial": {**START, "q": 1}}, "initial: expected variables x, y, v, theta; got 'q'"),
        ({"initial": {"x": 0}}, "initial: 'y' is missing; expected x, y, v, theta"),
        (
            {"initial": {**START, ("x", "y"): rp.JointNormal([0, 0], np.eye(2))}},
            "initial: 'x' is given twice",
        ),
        (
            {"initial": {("x", "theta"): rp.JointNormal([0, 0], np.eye(2)), "y": 0, "v": 0}},
            "initial: 'theta' is an angle and must be independent of the other variables",
        ),
        (
            {"initial": {("x", "y"): rp.JointNormal([0], [[1]]), "v": 0, "theta": 0}},
            "initial[('x', 'y')]: expected 2 variables, got 1",
        ),
        ({"initial": {("x", "y"): 1, "v": 0, "theta": 0}}, "initial[('x', 'y')]: expected a JointNormal, got int"),
        ({"initial": {**START, "v": "fast"}}, "initial['v']: expected a random variable or a number, got str"),
        ({"controls": []}, "controls: expected at least one mode, got none"),
        ({"controls": None}, "controls: expected a mapping for each mode, in a list, got None"),
        ({"controls": "keep"}, "controls: expected a mapping for each mode, in a list, got 'keep'"),
        ({"controls": [3]}, "controls[0]: expected a mapping from w_v, w_theta to random variables, got int"),
        ({"controls": {"w_v": 0}}, "controls[0]: 'w_theta' is missing; expected w_v, w_theta"),
        ({"controls": {**KEEP, "w_x": 0}}, "controls[0]: expected noises w_v, w_theta; got 'w_x'"),
        ({"controls": {**KEEP, "w_v": [0, 0]}}, "controls[0]['w_v']: expected one for each of 3 steps, got 2"),
        (
            {"controls": {**KEEP, "w_v": [0, 0, None]}},
            "controls[0]['w_v'][2]: expected a random variable or a number, got NoneType",
        ),
        ({"controls": [KEEP, BRAKE]}, "weights: expected one for each of 2 modes, got none"),
        ({"weights": [0.5]}, "weights: expected weights that sum to 1, got a sum of 0.5"),
        (
            {"controls": [KEEP, BRAKE], "weights": [[0.5, 0.5]] * 3},
            "weights: expected (K,) for persistent modes, got one row a step; use modes='per_step'",
        ),
        ({"modes": "sometimes"}, "modes: expected one of persistent, per_step; got 'sometimes'"),
        ({"times": [0.1, 0.25]}, "times[1]: expected a multiple of dt = 0.1 s from 0 to 0.3 s, got 0.25"),
        ({"times": [0.1, 0.4]}, "times[1]: expected a multiple of dt = 0.1 s from 0 to 0.3 s, got 0.4"),
        ({"length": -1.0}, "length: expected a finite number in (0, 1e+06], got -1.0"),
        ({"name": 3}, "name: expected text, got 3"),
    ],
)
def test_refusals(change, message):
    given = {"system": DUBINS, "initial": START, "controls": KEEP, "steps": 3}
    with pytest.raises(rp.InputError) as error:
        rp.ControlPrediction(**{**given, **change})
    assert str(error.value) == message


@pytest.mark.parametrize("order", [1, 13, 2.0, True])
def test_orders_that_are_refused(order):
    with pytest.raises(rp.InputError, match=f"moments: expected an order from 2 to 12, got {order!r}"):
        car().moments(order)


def test_a_negative_count_is_refused():
    with pytest.raises(rp.InputError, match="sample: expected a count >= 0, got -1"):
        car().sample(-1, np.random.default_rng(0))
    with pytest.raises(rp.InputError, match="sample: expected a count >= 0, got True"):
        car().sample(True, np.random.default_rng(0))
    with pytest.raises(rp.InputError, match="sample: rng: expected a numpy Generator such as .* got 0"):
        car().sample(3, 0)


def test_an_array_of_no_axes_is_a_number():
    car = rp.ControlPrediction(DUBINS, START, {**KEEP, "w_v": np.array(0.5)}, 3)
    assert car.controls[0].components[0][0][0] == rp.Constant(0.5)
