"""The command: exit status, one line on stderr, pure JSON, nothing half-written, the same numbers again."""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import riskplan as rp
from riskplan import interrupt
from riskplan.cli import main
from riskplan.report_table import report_view
from riskplan.rounding import lower, risk_text, upper

DEMO = Path(rp.__file__).parent / "data" / "overtake.yaml"
SMALL = """
version: 1
time_step: 0.1
horizon: 1.0
bounds: [-10, -5, 60, 5]
start: {x: 0, y: 0, heading: 0, speed: 10}
goal: {regions: [{box: [4, -4, 30, 4]}]}
agents:
  - name: car
    gaussian:
      times: [0, 1]
      weights: [0.4, 0.6]
      means: [[[30, 3.5], [30, -3.5]], [[30, 3.5], [30, -3.5]]]
      covariances:
        - [[[0.3, 0], [0, 0.2]], [[0.1, 0.05], [0.05, 0.2]]]
        - [[[0.3, 0], [0, 0.2]], [[0.1, 0.05], [0.05, 0.2]]]
"""
QUICK = ("--monte-carlo", "1000", "--time-limit", "20")


def program(*args, timeout=60, **options):
    command = [sys.executable, "-m", "riskplan", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False, **options)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.yaml"
    path.write_text(SMALL)
    return path


@pytest.fixture(scope="module")
def planned(scene):
    """A directory that `riskplan plan --out` filled, and what it printed."""
    done = program("plan", scene, "--out", scene.parent / "out", "--json", *QUICK)
    assert (done.returncode, done.stderr) == (0, "")
    return scene.parent / "out", json.loads(done.stdout)


BAD_SCENES = {
    "malformed YAML": ("bounds: [", "bounds: [[", "line 6, column 1: not valid YAML"),
    "unknown key": ("heading: 0", "hedaing: 0", "start.hedaing: unknown key; expected one of x, y, heading, speed"),
    "NaN": ("x: 0", "x: .nan", "start.x: expected a finite number, got nan"),
    "covariance": ("[0.1, 0.05], [0.05", "[0.1, 0.9], [0.9", "agents[0] (car): covariances[0, 1]: expected a positive"),
    "weights": ("0.6]", "0.5]", "agents[0] (car): weights: expected weights that sum to 1, got a sum of 0.9"),
    "times": ("times: [0, 1]", "times: [1, 0]", "agents[0] (car): times[1]: expected times to increase, got 0 after 1"),
    "start": ("x: 0", "x: 99", "start: (99, 0) lies outside the bounds [-10.0, -5.0, 60.0, 5.0]"),
}


def refused(capfd, *args):
    """Run in this process and return the one line on stderr."""
    assert main([str(a) for a in args]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("riskplan: error: ")
    assert err.count("\n") == 1
    return err.removeprefix("riskplan: error: ").rstrip("\n")


@pytest.mark.parametrize("case", BAD_SCENES)
def test_bad_scene(tmp_path, case):
    old, new, expected = BAD_SCENES[case]
    path = tmp_path / "bad.yaml"
    path.write_text(SMALL.replace(old, new, 1))
    done = program("plan", path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"riskplan: error: {path}: {expected}")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("missing.yaml", None, "no such file"),
        ("missing.xml", None, "no such file"),
        ("bad.xml", "<commonRoad", "malformed XML"),
        ("other.xml", "<a/>", "not a CommonRoad file"),
        ("scene.csv", "a", "not an Argoverse forecasting file"),
        ("scene.txt", "a", "expected a scenario in one of .yaml, .yml, .xml, .csv, .parquet; got .txt"),
    ],
)
def test_bad_file(tmp_path, name, content, expected):
    if content is not None:
        (tmp_path / name).write_text(content)
    done = program("plan", tmp_path / name)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"riskplan: error: {tmp_path / name}: {expected}")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (("--planner", "astar"), "planner: expected one of rrt, rrt-star, prm, "),
        (("--checker", "magic"), "checker: expected one of exact, imhof, liu, chebyshev"),
        (("--audit", "exact,magic"), "checker: expected one of exact, imhof, liu, chebyshev"),
        (("--bound", "2"), "bound: expected a finite number in [0, 1], got 2.0"),
        (("--bound", "nan"), "bound: expected a finite number in [0, 1], got nan"),
        (("--bound", "low"), "argument --bound: invalid risk value: 'low'"),
        (("--dependence", "some"), "dependence: expected one of independent, persistent, boole; got 'some'"),
        (("--time-limit", "-1"), "time_limit: expected a finite number in [0, inf], got -1.0"),
        (("--seed", "-1"), "seed: expected an integer in [0, 2^31), got -1"),
        (("--monte-carlo", "-1"), "monte_carlo: expected an integer >= 0, got -1"),
        (("--problem", "3"), "problem: expected 0"),
        (("--frobnicate",), "unrecognized arguments: --frobnicate"),
        (("--json", "--bou", "1"), "unrecognized arguments: --bou 1"),
    ],
)
def test_bad_option(capfd, scene, args, expected):
    assert refused(capfd, "plan", scene, *args).startswith(expected)


def test_unknown_planner_and_checker_as_a_program(scene):
    for option, valid in (
        ("--planner", ", ".join(rp.planners())),
        ("--checker", ", ".join(rp.checkers())),
    ):
        done = program("plan", scene, option, "magic")
        assert (done.returncode, done.stdout) == (2, "")
        name = option.removeprefix("--")
        assert done.stderr == f"riskplan: error: {name}: expected one of {valid}; got 'magic'\n"


def test_bad_command_lines(capfd, scene, tmp_path):
    assert "COMMAND" in refused(capfd)
    assert "invalid choice: 'fly'" in refused(capfd, "fly")
    assert "SCENARIO" in refused(capfd, "plan")
    assert "no such file" in refused(capfd, "assess", scene, tmp_path / "no.json")
    assert "expected a suffix out of .html" in refused(capfd, "render", scene, "--out", tmp_path / "a.bmp")
    (tmp_path / "file").write_text("")
    assert "cannot make the directory" in refused(capfd, "render", scene, "--out", tmp_path / "file" / "a.png")
    assert "cannot be a directory" in refused(capfd, "plan", scene, "--out", scene / "below")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_plan_writes_everything_and_prints_pure_json(scene, planned):
    out, told = planned
    assert sorted(p.name for p in out.iterdir()) == ["plan.json", "report.json", "scene.html", "scene.png"]
    assert sorted(p.name for p in out.parent.iterdir()) == ["out", "scene.yaml"]
    assert told["status"] == "solved"
    assert told["plan"] == json.loads((out / "plan.json").read_text())
    assert told["report"] == json.loads((out / "report.json").read_text())
    assert told["report"]["within_bound"] is True
    assert told["files"]["plan.json"] == str(out / "plan.json")


def test_same_seed_same_plan(scene, planned):
    again = json.loads(program("plan", scene, "--json", *QUICK).stdout)
    for key in ("trajectory", "risk", "marginals", "settings", "versions"):
        assert again["plan"][key] == planned[1]["plan"][key]


@pytest.mark.parametrize(("checker", "dependence"), [("exact", "independent"), ("sos", "boole"), ("imhof", "boole")])
def test_assess_reproduces_the_numbers_bit_for_bit(scene, tmp_path, capfd, checker, dependence):
    options = ("--bound", "none", "--time-limit", "0.3", "--monte-carlo", "0")
    assert (
        main(
            [
                "plan",
                str(scene),
                "--checker",
                checker,
                "--dependence",
                dependence,
                "--out",
                str(tmp_path / "o"),
                *options,
            ]
        )
        == 0
    )
    capfd.readouterr()
    stored = json.loads((tmp_path / "o" / "plan.json").read_text())
    done = program("assess", scene, tmp_path / "o" / "plan.json", "--json", "--monte-carlo", "0")
    told = json.loads(done.stdout)
    assert (done.returncode, done.stderr) == (0, "")
    assert told["reproduced"] is True
    assert told["plan"]["risk"] == stored["risk"]
    assert told["plan"]["marginals"] == stored["marginals"]
    assert told["report"]["verdicts"][0]["checker"] == checker
    assert told["report"]["verdicts"][0]["risk"] == stored["risk"]


def test_assess_keeps_the_checker_options_of_the_plan(scene, tmp_path, capfd):
    plan = rp.plan(rp.load_scenario(scene), checker=rp.checker("sos", order=6), bound=1.0, time_limit=20.0)
    rp.save_plan(plan, tmp_path / "plan.json")
    assert main(["assess", str(scene), str(tmp_path / "plan.json"), "--json", "--monte-carlo", "0"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told["reproduced"] is True
    assert told["report"]["verdicts"][0]["risk"]["total"] == float(plan.risk.total)


@pytest.mark.parametrize("planner", ["rrt", "prm"])
def test_plans_with_errors_that_persist(scene, tmp_path, capfd, planner):
    out = str(tmp_path / "o")
    wanted = ["--dependence", "persistent", "--planner", planner, "--bound", "0.3", "--time-limit", "20"]
    assert main(["plan", str(scene), *wanted, "--monte-carlo", "1000", "--out", out]) == 0
    note = "riskplan: note: 1 of 1 agents carry no factors: their errors are taken to persist\n"
    assert capfd.readouterr().err == note
    assert main(["assess", str(scene), out + "/plan.json", "--json", "--monte-carlo", "0"]) == 0
    told, err = capfd.readouterr()
    assert json.loads(told)["reproduced"] is True
    assert err == note
    assert json.loads(told)["plan"]["risk"]["dependence"] == "persistent"


def test_assess_by_several_checkers(scene, planned, capfd):
    path = planned[0] / "plan.json"
    assert main(["assess", str(scene), str(path), "--checker", "exact,sos", "--checker", "chebyshev", *QUICK[:2]]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert max(map(len, out.splitlines())) <= 100
    for word in ("exact", "sos", "chebyshev", "Monte Carlo", "99% interval", "car", "total", "(Boole)", "Fréchet"):
        assert word in out


def test_assess_tells_a_tampered_or_unsafe_plan(scene, planned, tmp_path, capfd):
    d = json.loads((planned[0] / "plan.json").read_text())
    # into the agents, with the old risk still claimed
    d["trajectory"]["poses"] = [[30.0, 3.5, 0.0] for _ in d["trajectory"]["poses"]]
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(d))
    assert main(["assess", str(scene), str(path), "--json", "--monte-carlo", "100"]) == 1
    out, err = capfd.readouterr()
    told = json.loads(out)
    assert told["reproduced"] is False
    assert told["report"]["within_bound"] is False
    assert told["plan"]["risk"]["total"] > 0.1
    assert err.startswith("riskplan: note: ")
    d["trajectory"]["times"] = [t + 0.05 for t in d["trajectory"]["times"]]
    path.write_text(json.dumps(d))
    assert "expected the scenario's grid" in refused(capfd, "assess", scene, path)


def test_no_plan_is_exit_1(scene, tmp_path, capfd):
    path = tmp_path / "far.yaml"
    path.write_text(SMALL.replace("[4, -4, 30, 4]", "[55, -4, 59, 4]"))
    done = program("plan", path, "--json", "--out", tmp_path / "out")
    told = json.loads(done.stdout)
    assert (done.returncode, done.stderr) == (1, "")
    assert (told["status"], told["report"]) == ("goal_unreachable", None)
    assert told["plan"]["trajectory"]["times"] == []
    assert sorted(told["files"]) == ["plan.json", "scene.html", "scene.png"]
    assert main(["plan", str(path)]) == 1
    assert "goal unreachable" in capfd.readouterr().out
    assert "expected a plan with a trajectory" in refused(capfd, "assess", path, tmp_path / "out" / "plan.json")


def test_render(scene, planned, tmp_path, capfd):
    for name, plan in (("a.png", [planned[0] / "plan.json"]), ("b.html", [])):
        assert main(["render", str(scene), *map(str, plan), "--out", str(tmp_path / name)]) == 0
    assert capfd.readouterr() == ("", "")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.html"]


def test_lists_and_version(capfd):
    assert main(["checkers", "--json"]) == 0
    assert set(json.loads(capfd.readouterr().out)) == set(rp.checkers())
    assert main(["planners", "--json"]) == 0
    assert set(json.loads(capfd.readouterr().out)) == set(rp.planners())
    for command in ("checkers", "planners"):
        assert main([command]) == 0
        assert max(map(len, capfd.readouterr().out.splitlines())) <= 100
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    assert capfd.readouterr().out.startswith(f"riskplan {rp.__version__} (python 3.")


def test_demo(tmp_path):
    done = program("demo", "--out", tmp_path / "demo", "--json", timeout=120)
    note = "riskplan: note: planning the hand-made scene instead: LearnedPredictor needs torch"
    assert done.returncode == 0
    assert done.stderr == "" if importlib.util.find_spec("torch") else done.stderr.startswith(note)
    told = json.loads(done.stdout)
    for planner in ("rrt", "prm"):
        files = sorted(p.name for p in (tmp_path / "demo" / planner).iterdir())
        assert files == ["plan.json", "report.json", "scene.html", "scene.png"]
        assert told[planner]["status"] == "solved"
        assert told[planner]["plan"]["risk"]["total"] <= 0.05
        assert told[planner]["report"]["consistent"] is True


@pytest.mark.parametrize("planner", ["rrt", "prm"])
def test_demo_scene_is_solved_quickly_by_any_seed(planner):
    scenario = rp.load_scenario(DEMO)
    rp.plan(scenario, planner=planner, bound=0.05, time_limit=60.0)  # compiles
    seconds = []
    for seed in range(5):
        began = time.process_time()
        assert rp.plan(scenario, planner=planner, bound=0.05, time_limit=30.0, seed=seed).solved
        seconds.append(time.process_time() - began)
    assert max(seconds) < 2.0


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize(("planner", "wait"), [("rrt", 1.5), ("prm", 1.5), ("rrt", 0.4), ("prm", 3.0)])
def test_ctrl_c(tmp_path, planner, wait):
    command = [sys.executable, "-m", "riskplan", "plan", str(DEMO), "--planner", planner, "--bound", "none"]
    command += ["--time-limit", "60", "--out", str(tmp_path / "out")]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(wait)
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=40)
    assert (running.returncode, out, err) == (130, "", "riskplan: interrupted\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_while_writing_leaves_nothing(scene, tmp_path, monkeypatch, capfd):
    def interrupted(*_):
        assert any(tmp_path.iterdir())  # something is there already, aside
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("riskplan.outputs.render", interrupted)
    assert main(["plan", str(scene), "--out", str(tmp_path / "out"), *QUICK]) == 130
    assert capfd.readouterr() == ("", "riskplan: interrupted\n")
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_an_interrupt_lost_in_a_callback_still_ends_the_search(scene):
    scenario = rp.load_scenario(scene)
    with interrupt.listening():
        with pytest.raises(KeyboardInterrupt):  # what compiled code swallows
            signal.raise_signal(signal.SIGINT)
        began = time.monotonic()
        rp.plan(scenario, bound=None, time_limit=60.0, stop=interrupt.requested)
        assert time.monotonic() - began < 30.0
        with pytest.raises(KeyboardInterrupt):
            interrupt.check()


def test_a_bug_is_neither_no_plan_nor_bad_input(scene, monkeypatch, capfd):
    def broken(*_):
        raise RuntimeError("a bug")

    monkeypatch.setattr("riskplan.io.load_scenario", broken)
    assert main(["plan", str(scene)]) == 70
    assert "RuntimeError: a bug" in capfd.readouterr().err


def test_a_reader_that_goes_away(scene):
    command = f"{sys.executable} -m riskplan checkers | true"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert done.stderr == ""


def test_ascii_output(scene, planned):
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = program("assess", scene, planned[0] / "plan.json", *QUICK[:2], env=environment)
    assert (done.returncode, done.stderr) == (0, "")


def test_import_is_fast_and_light():
    heavy = ("numba", "ompl", "torch", "meshcat", "matplotlib", "shapely", "jsonschema", "rich", "scipy")
    code = f"import sys, riskplan; print([m for m in {heavy} if m in sys.modules])"
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
        seconds.append(time.perf_counter() - began)
        assert done.stdout == "[]\n"
    assert min(seconds) < 0.5


def test_value_types_and_readers_are_light_too():
    code = (
        f"import sys, riskplan as rp; rp.load_scenario({str(DEMO)!r}); rp.Plan; rp.Goal; rp.InputError; rp.load_plan; "
    )
    code += "print([m for m in ('numba', 'ompl', 'torch', 'meshcat', 'matplotlib', 'shapely') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("value", [*10.0 ** np.random.default_rng(0).uniform(-320, 0, 300), 1.0, 0.0, 0.9996, 5e-324])
def test_printed_ends_never_understate(value):
    assert float(upper(value)) >= value
    assert float(lower(value)) <= value
    assert float(risk_text(value)) == pytest.approx(value, rel=5.1e-3, abs=5e-324)


@pytest.mark.parametrize(
    ("value", "near", "up", "down"),
    [
        (0.012345, "0.0123", "0.0124", "0.0123"),
        (0.9999, "1.00", "1.00", "0.999"),
        (1.0, "1.00", "1.00", "1.00"),
        (0.0, "0", "0", "0"),
        (1.2345e-20, "1.23e-20", "1.24e-20", "1.23e-20"),
        (float("nan"), "-", "-", "-"),
    ],
)
def test_printed_risks(value, near, up, down):
    assert (risk_text(value), upper(value), lower(value)) == (near, up, down)


def test_report_fits_100_columns_with_many_checkers_and_odd_names(scene):
    plan = rp.plan(rp.load_scenario(scene), bound=1.0, time_limit=20.0)
    names = ["exact", "imhof", "sos", "chebyshev", "halfspace", "monte-carlo"]
    scenario = rp.load_scenario(scene)
    report = rp.audit(plan, scenario, names, monte_carlo=1000)
    report = type(report)(**{**vars(report), "agents": ("[bold]a very long name of an agent indeed[/bold]",)})
    console = Console(width=100, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(report_view(plan, report))
    text = console.export_text()
    console.file.close()
    assert max(map(len, text.splitlines())) <= 100
    assert "[bold]a very long name" in text
    assert all(name in text for name in names)
    assert "\n\n\n" not in text


def test_the_wheel_holds_the_data():
    assert shutil.which("riskplan", path=str(Path(sys.executable).parent))
    for name in ("data/overtake.yaml", "io/scenario.schema.json", "py.typed"):
        assert (Path(rp.__file__).parent / name).is_file()
