"""The Pareto front over bounds, and the spending of one budget along the way."""

import json

import numpy as np
import pytest

import riskplan as rp
from riskplan.cli import main
from riskplan.io.plan_file import report_to_dict
from riskplan.pareto import sweep_rows
from riskplan.report_table import report_view
from tests.scenes import overtake


def test_looser_bounds_never_cost_more():
    points = rp.sweep(overtake(), [0.1, 1e-12, 0.01, 0.02], iterations=1200, time_limit=60.0, seed=1)
    assert [p.bound for p in points] == [1e-12, 0.01, 0.02, 0.1]
    assert points[0].best is None and np.isnan(points[0].arrival) and not points[0].on_front
    known = points[1:]
    assert all(p.risk <= p.bound for p in known)
    assert (np.diff([p.cost for p in known]) <= 0).all()
    for before, point in zip(known, known[1:], strict=False):
        assert point.on_front == (point.cost < before.cost)
    assert json.dumps(sweep_rows(points), allow_nan=False)
    with pytest.raises(rp.InputError, match="bounds: expected at least one"):
        rp.sweep(overtake(), [])
    with pytest.raises(rp.InputError, match=r"bounds\[1\]: expected a finite number in \[0, 1\], got 2"):
        rp.sweep(overtake(), [0.1, 2.0])


def test_from_the_shell(tmp_path, capsys):
    command = ["sweep", "riskplan/data/overtake.yaml", "--bounds", "0.05,0.3", "--iterations", "500"]
    assert main([*command, "--time-limit", "60", "--out", str(tmp_path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [p["bound"] for p in told["points"]] == [0.05, 0.3]
    assert json.loads((tmp_path / "sweep.json").read_text())["points"] == told["points"]
    assert (tmp_path / "sweep.png").stat().st_size > 5000
    assert main(["sweep", "riskplan/data/overtake.yaml", "--bounds", "a"]) == 2
    assert "--bounds: expected numbers" in capsys.readouterr().err


@pytest.mark.parametrize("dependence", ["independent", "boole", "persistent"])
def test_spending_ends_at_the_total_and_never_falls(dependence):
    scene = overtake()
    if dependence == "persistent":
        scene = scene.with_agents([rp.persistent(a) for a in scene.agents])
    plan = rp.plan(scene, bound=0.05, dependence=dependence, time_limit=20.0, seed=1)
    report = rp.audit(plan, scene, monte_carlo=0)
    assert report.spending.shape == (len(plan.times), 3)
    assert (np.diff(report.spending, axis=0) >= -1e-15).all()
    np.testing.assert_allclose(report.spending[-1], plan.risk.per_agent, rtol=1e-9, atol=1e-14 * float(plan.risk.total))
    if dependence != "persistent":  # the same as judging the first part of the way
        half = len(plan.times) // 2
        agents = [a.at(plan.times[:half]) for a in scene.agents]
        risks = [rp.checker("exact")(plan.poses[:half], a, scene.ego) for a in agents]
        part = rp.trajectory_risk(risks, agents, dependence)
        np.testing.assert_allclose(
            report.spending[half - 1], part.per_agent, rtol=1e-9, atol=1e-14 * float(plan.risk.total)
        )
    told = report_to_dict(report)["spending"]
    assert told["total"][-1] == pytest.approx(float(plan.risk.total), rel=1e-9)
    from rich.console import Console

    console = Console(width=100)
    with console.capture() as shown:
        console.print(report_view(plan, report))
    assert "risk so far" in shown.get() and "of the bound" in shown.get()
