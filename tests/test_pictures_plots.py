"""Plots, risk maps and notebooks: what they show against numbers computed another way."""

from __future__ import annotations

import dataclasses
import io
import re
import subprocess
import sys
from base64 import b64decode

import numpy as np
import pytest
from PIL import Image

import riskplan as rp
from checkers import EgoEllipsoid, GaussianMixturePrediction, InputError
from riskplan.pictures import plots
from riskplan.pictures.picture import spent
from tests.pictured import TIMES, overtake, overtaking_plan, unsolved


@pytest.fixture(scope="module")
def scenario():
    return overtake()


@pytest.fixture(scope="module")
def plan(scenario):
    return overtaking_plan(scenario, edges=50)


def line(figure, label):
    (found,) = [one for one in figure.axes[0].lines if one.get_label() == label]
    return found.get_xydata()


def test_risk_over_time_draws_what_the_backend_says_within_the_band(scenario, plan):
    figure = plots.risk_over_time(scenario, plan, ["exact", "halfspace"], samples=3000, seed=2)
    report = rp.audit(plan, scenario, ["exact", "halfspace"], monte_carlo=0)
    exact, halfspace = (verdict.risk.per_step for verdict in report.verdicts)
    drawn = line(figure, "exact (upper bound)")[:, 1]
    seen = np.isfinite(drawn)
    np.testing.assert_allclose(drawn[seen], exact[seen])
    np.testing.assert_allclose(line(figure, "halfspace (upper bound)")[:, 1], halfspace)
    hits = plots.sampled_hits(scenario, plan, 3000, seed=2)
    low, _ = plots.clopper_pearson(hits, 3000, 0.999999)
    assert (low <= exact).all()  # the union of the pieces is at most their sum
    assert hits.max() / 3000 > 0.2 * exact.max()


def test_sampled_hits_of_one_ellipse_match_the_exact_risk(scenario, plan):
    single = dataclasses.replace(scenario, ego=EgoEllipsoid(np.diag([1 / 3.0**2, 1 / 1.5**2])))
    hits = plots.sampled_hits(single, plan, 20_000, seed=1)
    exact = rp.audit(plan, single, ["exact"], monte_carlo=0).verdicts[0].risk.per_step
    low, high = plots.clopper_pearson(hits, 20_000, 1 - 1e-9)
    # agents are added up, so `exact` may lie above by what two of them hit at once
    assert (low <= exact + 1e-12).all()
    assert (exact <= high + exact**2).all()


def test_budget_ends_at_the_total_of_the_plan(scenario, plan):
    rows = spent(scenario, plan)
    assert (np.diff(rows, axis=0) >= 0).all()
    np.testing.assert_allclose(rows[-1], plan.risk.per_agent)
    figure = plots.budget(scenario, plan)
    top = max(path.vertices[:, 1].max() for area in figure.axes[0].collections for path in area.get_paths())
    assert top == pytest.approx(float(plan.risk.total))
    with pytest.raises(InputError, match=r"plan\.marginals"):
        plots.budget(scenario, dataclasses.replace(plan, marginals=()))


def test_boole_spends_the_sum_of_the_steps(scenario, plan):
    boole = dataclasses.replace(plan, risk=dataclasses.replace(plan.risk, dependence="boole"))
    sums = [(m @ a.weights).sum() for m, a in zip(plan.marginals, scenario.agents, strict=True)]
    np.testing.assert_allclose(spent(scenario, boole)[-1], sums)


def test_pareto_front_is_what_nothing_beats():
    rng = np.random.default_rng(0)
    cost, risk = rng.uniform(1, 2, 50), rng.uniform(1e-4, 1e-1, 50)
    front = line(plots.pareto({"rrt": (cost, risk)}), "rrt")
    beaten = ((cost[None] < cost[:, None]) & (risk[None] < risk[:, None])).any(axis=1)
    expected = np.column_stack([cost, risk])[~beaten]
    np.testing.assert_allclose(front, expected[np.argsort(expected[:, 0])])


def test_reliability_of_a_true_statement_lies_on_the_line():
    rng = np.random.default_rng(0)
    stated = rng.uniform(0.05, 0.95, 40_000)
    figure = plots.reliability({"true": (stated, rng.random(40_000) < stated)}, bins=5)
    said, share = figure.axes[0].containers[0].lines[0].get_xydata().T
    assert said == pytest.approx(np.arange(0.14, 0.95, 0.18), abs=0.01)
    assert share == pytest.approx(said, abs=0.02)


def test_tightness_is_the_share_within_a_factor():
    figure = plots.tightness([1e-3, 1e-3, 1e-3, 1e-3], {"sos": [2e-3, 1e-2, 1e-3, 1.0]})
    np.testing.assert_allclose(line(figure, "sos"), [[1, 0.25], [2, 0.5], [10, 0.75], [1000, 1.0]])


@pytest.mark.parametrize("bad", [([1.0], [1.0, 2.0]), ([], []), ([np.nan], [1.0])])
def test_bad_arrays_are_named(bad):
    with pytest.raises(InputError, match="^rrt: expected"):
        plots.pareto({"rrt": bad})


def test_risk_map_is_the_backend_at_every_place(scenario):
    found = rp.risk_map(scenario, 2.0, spacing=2.0, window=(0.0, -5.0, 60.0, 5.0))
    assert found.risk.shape == (len(found.y), len(found.x))
    for i, j in ((1, 3), (3, 20), (5, 28)):
        pose = np.array([[found.x[j], found.y[i], scenario.start.heading]])
        risks = [rp.checker("exact")(pose, a.at([2.0]), scenario.ego).value[0] @ a.weights for a in scenario.agents]
        assert found.risk[i, j] == pytest.approx(min(sum(risks), 1.0))
    assert found.kind == "upper bound"


def test_risk_map_of_a_round_agent_is_round():
    mean, spread = np.full((2, 1, 2), 5.0), np.tile(np.eye(2) * 0.8, (2, 1, 1, 1))
    agent = GaussianMixturePrediction([0.0, 1.0], [1.0], mean, spread)
    scene = rp.Scenario(
        rp.State(0, 0, 0.7), rp.Goal.at(9, 9), (0, 0, 10, 10), agents=[agent], ego=EgoEllipsoid(np.eye(2))
    )
    found = rp.risk_map(scene, 0.5, spacing=0.5)
    np.testing.assert_allclose(found.risk, found.risk.T, rtol=1e-9)
    np.testing.assert_allclose(found.risk, found.risk[::-1], rtol=1e-7, atol=1e-15)
    assert found.risk[10, 10] == found.risk.max() == pytest.approx(1 - np.exp(-1 / (2 * 0.8)))  # Rayleigh
    assert found.kind == "exact"


def test_risk_map_refuses_what_makes_no_sense(scenario):
    with pytest.raises(InputError, match="more than 400000 places"):
        rp.risk_map(scenario, 1.0, spacing=0.01)
    with pytest.raises(InputError, match="window: expected"):
        rp.risk_map(scenario, 1.0, window=(1.0, 0.0, 0.0, 1.0))
    with pytest.raises(InputError, match="agents: expected at least one"):
        rp.risk_map(scenario.with_agents(()), 1.0)


def test_figures_are_written_with_the_same_bytes(scenario, plan, tmp_path):
    found = rp.risk_map(scenario, 2.0, spacing=1.0)
    drawers = [
        lambda: plots.risk_map(found, scenario, plan),
        lambda: plots.risk_surface(found),
        lambda: plots.budget(scenario, plan),
    ]
    for i, drawer in enumerate(drawers):
        a, b = (plots.save(drawer(), tmp_path / f"{name}{i}.png").read_bytes() for name in "ab")
        assert a == b
        assert Image.open(io.BytesIO(a)).size[0] > 600


def test_the_map_is_drawn_where_the_plan_is(scenario, plan):
    found = rp.risk_map(scenario, 2.0, spacing=1.0)
    axes = plots.risk_map(found, scenario, plan).axes[0]
    (at,) = axes.lines[-1].get_xydata()
    np.testing.assert_allclose(at, plan.poses[np.abs(TIMES - 2.0).argmin(), :2])


def picture_in(text):
    return Image.open(io.BytesIO(b64decode(re.search(r'src="data:image/png;base64,([^"]+)"', text).group(1))))


def test_scenarios_and_plans_show_a_picture_in_notebooks(scenario, plan):
    assert picture_in(scenario._repr_html_()).width == 900
    text = plan._repr_html_()
    assert picture_in(text).width == 900
    assert "solved" in text
    assert f"{float(plan.risk.total):.2g}" in text
    no_plan = dataclasses.replace(unsolved(), message="nothing <found>")
    assert "<img" not in no_plan._repr_html_()
    assert "nothing &lt;found&gt;" in no_plan._repr_html_()


def test_reports_and_predictions_show_a_table(scenario, plan):
    text = rp.audit(plan, scenario, ["halfspace"], monte_carlo=200)._repr_html_()
    for part in ("halfspace", "Monte Carlo, 200", "truck", "upper bound"):
        assert part in text
    hostile = dataclasses.replace(scenario.agents[0], name="<b>")
    table = hostile._repr_html_()
    assert "&lt;b&gt;: GaussianMixturePrediction" in table
    assert table.count("<tr>") == 4
    assert "moments to order 4" in scenario.agents[0].moments(4)._repr_html_()


def test_value_types_import_no_pictures():
    code = "import sys, riskplan.result, riskplan.scene; print([m for m in sys.modules if 'pictures' in m])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
