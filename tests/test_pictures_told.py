"""What a picture says of risk so far, samples and densities, and what it takes for granted."""

from __future__ import annotations

import dataclasses
import html
import json
import re

import numpy as np
import pytest

from checkers import ControlPrediction, Normal, Uniform, dynamics, path_risk, persistent
from riskplan.pictures import overlay, palette, plots, render, top
from riskplan.pictures.agent_view import Detail
from riskplan.pictures.picture import legend, picture, spent
from riskplan.scene import Scenario
from tests.pictured import overtake, overtaking_plan


@pytest.fixture(scope="module")
def scenario():
    return overtake()


@pytest.fixture(scope="module")
def plan(scenario):
    return overtaking_plan(scenario)


@pytest.fixture(scope="module")
def lasting(scenario):
    """The scene with errors that persist, and the same way judged so: first hits instead of marginals."""
    agents = [persistent(agent) for agent in scenario.agents[1:2]]
    scene = scenario.with_agents(agents)
    plan = overtaking_plan(scenario, edges=50)
    plan = dataclasses.replace(plan, marginals=plan.marginals[1:2])
    risk = path_risk(plan.poses, agents, scene.ego, "persistent")
    return scene, dataclasses.replace(plan, risk=risk, settings={**plan.settings, "dependence": "persistent"})


def test_bare_moments_have_no_futures_and_gaussians_do(scenario, plan):
    mixed = dataclasses.replace(scenario, agents=(scenario.agents[0], scenario.agents[1].moments(4)))
    known, moments = picture(mixed, plan, None, Detail(7, 5, 0)).agents
    assert known.futures.shape[0] == 7
    assert len(known.dots) == 5 * known.futures.shape[1]
    assert moments.futures.shape[0] == 0
    assert len(moments.dots) == 5 * len(moments.means)
    np.testing.assert_allclose(moments.covariances, scenario.agents[1].covariances[::3][: len(moments.covariances)])


def test_sampled_positions_have_the_moments_of_the_prediction(scenario):
    from riskplan.pictures.agent_view import Detail

    agent = picture(scenario, None, None, Detail(0, 4000, 1)).agents[1]
    dots = agent.dots.reshape(4000, -1, 2)[:, -1]
    mean = (agent.weights[-1][:, None] * agent.means[-1]).sum(axis=0)
    np.testing.assert_allclose(dots.mean(axis=0), mean, atol=0.4)


def test_risk_so_far_of_persistent_errors_is_that_of_first_hits(lasting):
    scene, plan = lasting
    pic = picture(scene, plan)
    assert (np.diff(pic.so_far) >= 0).all()
    assert pic.so_far[-1] == pytest.approx(float(plan.risk.total))
    part = 51
    until = [agent.at(plan.times[:part]) for agent in scene.agents]
    shorter = path_risk(plan.poses[:part], until, scene.ego, "persistent")
    assert 0.2 < float(shorter.total) < float(plan.risk.total)
    assert pic.so_far[part - 1] == pytest.approx(float(shorter.total), rel=5e-3)
    assert legend(pic)[0][0] == "first hit per step"


def test_the_budget_of_persistent_errors_is_that_of_first_hits(lasting):
    scene, plan = lasting
    rows = spent(scene, plan)
    total = float(plan.risk.total)
    # the planner's judge aims at 1e-6 of the total; the moment of the first hit comes out at a hundredth of it
    np.testing.assert_allclose(rows.sum(axis=1), np.cumsum(plan.risk.per_step), atol=0.01 * total)
    np.testing.assert_allclose(rows[-1], plan.risk.per_agent, rtol=1e-4)
    assert plots.budget(scene, plan).axes[0].collections


def test_risk_so_far_under_boole_is_the_sum_of_the_steps(scenario, plan):
    boole = dataclasses.replace(plan.risk, total=plan.risk.per_step.sum(), dependence="boole")
    pic = picture(scenario, dataclasses.replace(plan, risk=boole))
    np.testing.assert_allclose(pic.so_far, np.cumsum(plan.risk.per_step))
    assert legend(pic)[0][0] == "risk per step"


def test_the_page_reads_first_hits_out(lasting, tmp_path):
    scene, plan = lasting
    data = json.loads(re.search(r"^const data = (.*);$", render(scene, plan, tmp_path / "a.html").read_text(), re.M)[1])
    assert data["step"] == "first hit now"
    assert data["soFar"][-1].endswith(palette.number(float(plan.risk.total)))


def banana():
    """An agent by its controls, whose positions are bent as no Gaussian is."""
    where = {"x": 10.0, "y": 0.0, "v": 8.0, "theta": 0.0}
    controls = [{"w_v": Normal(0.0, 0.05), "w_theta": Uniform(-0.05, 0.05)}]
    return ControlPrediction(dynamics.dubins(0.1), where, controls, steps=60, name="bent")


def test_dots_of_an_agent_by_its_controls_are_its_own_samples(scenario):
    agent = banana()
    (view,) = picture(scenario.with_agents([agent]), None, None, Detail(0, 40, 3)).agents
    shown = np.arange(0, len(agent.times), 3)
    own = agent.sample(40, np.random.default_rng(3))[:, shown].reshape(-1, 2)
    np.testing.assert_allclose(view.dots, own)


def test_dots_of_bare_moments_are_of_the_gaussian_that_has_them(scenario):
    moments = banana().moments(4)
    (view,) = picture(scenario.with_agents([moments]), None, None, Detail(0, 6000, 3)).agents
    dots = view.dots.reshape(6000, -1, 2)[:, -1]
    np.testing.assert_allclose(dots.mean(axis=0), view.means[-1, 0], atol=0.1)
    np.testing.assert_allclose(np.cov(dots.T), view.covariances[-1, 0], rtol=0.06, atol=0.15)


MOMENTS = "of bare moments, of a Gaussian with the same mean and covariance"


@pytest.mark.parametrize(
    ("agents", "detail", "notes"),
    [
        ("gaussian", Detail(), ()),
        ("gaussian", Detail(3, 0, 0), ("lines: sampled futures; errors taken to persist",)),
        ("gaussian", Detail(0, 3, 0), ("dots: sampled positions",)),
        ("lasting", Detail(3, 0, 0), ("lines: sampled futures",)),
        ("moments", Detail(0, 3, 0), (f"dots: sampled positions; {MOMENTS}",)),
        ("moments", Detail(3, 0, 0), ("no futures: nothing but moments is known",)),
        ("controls", Detail(3, 3, 0), ("dots: sampled positions", "lines: sampled futures")),
        ("none", Detail(3, 3, 0), ()),
    ],
)
def test_what_is_taken_for_granted_is_in_the_legend(scenario, agents, detail, notes):
    car = scenario.agents[0]
    known = {"gaussian": [car], "lasting": [persistent(car)], "moments": [car.moments(2)], "controls": [banana()]}
    assert picture(scenario.with_agents(known.get(agents, [])), None, None, detail).notes == notes


def test_every_view_prints_what_is_taken_for_granted(scenario, plan, tmp_path):
    scene: Scenario = scenario.with_agents([scenario.agents[0].moments(2), *scenario.agents[1:]])
    page = render(scene, plan, tmp_path / "a.html", density=3).read_text()
    assert MOMENTS in html.unescape(re.sub("<[^>]+>", " ", page.split("</style>")[1].split("<script>")[0]))
    told = picture(scene, plan, None, Detail(0, 3, 0))
    silent = dataclasses.replace(told, notes=())
    size = (900, 400)
    above = [top.still(pic, size)[..., :3].astype(int) for pic in (told, silent)]
    changed = np.argwhere(np.abs(above[0] - above[1]).max(axis=-1) > 30)
    assert len(changed) > 100
    assert changed[:, 0].min() > 400 - 34  # below the view, not on it
    camera = overlay.view(told, size)
    cards = [np.asarray(overlay.card(pic, size, camera))[..., 3] > 0 for pic in (told, silent)]
    assert cards[0].sum() > 1.1 * cards[1].sum()
