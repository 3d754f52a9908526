"""What is shipped, and that the README says what is there."""

import importlib.util
import json
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest

import riskplan as rp
from riskplan.cli import main

try:
    import tomllib
except ImportError:  # Python 3.10
    import tomli as tomllib

ROOT = Path(__file__).parent.parent


def backend_rows():
    return [
        f"| `{name}` | {i.kind.value} | {i.needs} | {i.assumption} | {i.source} | {i.cost} | {options(name)} |"
        for name, i in rp.checkers().items()
    ]


def options(name):
    return ", ".join(f"{key}={value}" for key, value in rp.checker(name).defaults().items())


def test_readme_lists_the_backends_as_they_declare_themselves():
    text = (ROOT / "README.md").read_text()
    table = [line for line in text.splitlines() if line.startswith("| `") and line.count("|") == 8]
    assert table == backend_rows()


def test_readme_names_every_planner():
    text = (ROOT / "README.md").read_text()
    for name in rp.planners():
        assert f"- `{name}`: " in text


def test_public_names_exist():
    for name in set(rp.__all__) - ({"LearnedPredictor"} if importlib.util.find_spec("torch") is None else set()):
        assert getattr(rp, name) is not None


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """An sdist of the checkout, and the wheel made of that sdist."""
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True, timeout=600)
    return out


def test_wheel_has_exactly_three_roots_and_its_data(dist):
    (wheel,) = dist.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {n.split("/")[0] for n in names if ".dist-info" not in n} == {"checkers", "predictor", "riskplan"}
    for wanted in (
        "riskplan/py.typed",
        "checkers/py.typed",
        "predictor/py.typed",
        "riskplan/io/scenario.schema.json",
        "riskplan/data/overtake.yaml",
        "predictor/data/constant_velocity.json",
        "checkers/data/offline_sos.json",
    ):
        assert wanted in names
    assert not [n for n in names if n.endswith((".nbi", ".nbc", ".pyc"))]


def test_sdist_has_what_a_checkout_has(dist):
    (sdist,) = dist.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {n.partition("/")[2] for n in archive.getnames()}
    assert {"README.md", "CHANGELOG.md", "CITATION.cff", "LICENSE", "mkdocs.yml", "docs/index.md"} <= names
    assert {"tests/test_package.py", "tests/fuzz/corpus.py", "benchmarks/batch.py", "demos/quickstart.py"} <= names


@pytest.fixture(scope="module")
def installed(dist, tmp_path_factory):
    """The python of an environment that has the wheel, and this one's other packages."""
    folder = tmp_path_factory.mktemp("venv")
    venv.create(folder, with_pip=False)
    place = next(folder.glob("lib/python*/site-packages"))
    (place / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (wheel,) = dist.glob("*.whl")
    command = [sys.executable, "-m", "pip", "--quiet", "--python", str(folder), "install", "--no-deps", "--no-index"]
    subprocess.run([*command, "--ignore-installed", str(wheel)], check=True, capture_output=True, timeout=600)
    return folder


def test_the_wheel_works_installed(installed, tmp_path):
    # -I: neither PYTHONPATH nor the current directory, so nothing comes from the checkout
    code = "import checkers, predictor, riskplan; print(*(m.__path__[0] for m in (checkers, predictor, riskplan)))"
    run = {"capture_output": True, "text": True, "check": True, "timeout": 300, "cwd": tmp_path}
    paths = subprocess.run([installed / "bin" / "python", "-I", "-c", code], **run).stdout.split()
    assert all(Path(p).is_relative_to(installed) for p in paths) and len(paths) == 3
    program = [installed / "bin" / "python", "-I", "-m", "riskplan"]
    assert subprocess.run([installed / "bin" / "riskplan", "--version"], **run).stdout.startswith(
        "riskplan 0.1.0 (python 3"
    )
    assert json.loads(subprocess.run([*program, "doctor", "--json"], **run).stdout)["ok"]
    assert set(json.loads(subprocess.run([*program, "planners", "--json"], **run).stdout)) == set(rp.planners())


@pytest.mark.slow
def test_the_wheel_plans_installed(installed, tmp_path):
    command = [installed / "bin" / "python", "-I", "-m", "riskplan", "demo", "--out", tmp_path / "out"]
    subprocess.run(command, check=True, capture_output=True, timeout=600, cwd=tmp_path)
    assert (tmp_path / "out" / "rrt" / "plan.json").exists()


def test_versions_agree():
    told = (ROOT / "CITATION.cff").read_text()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"\nversion: {rp.__version__}\n" in told and project["version"] == rp.__version__
    assert f"\n## {rp.__version__}" in (ROOT / "CHANGELOG.md").read_text()


# commands that describe the package


def said(capsys, *words):
    status = main(list(words))
    return status, capsys.readouterr().out


def test_schema_is_printed_as_shipped(capsys):
    status, out = said(capsys, "schema")
    assert status == 0
    assert json.loads(out) == json.loads((ROOT / "riskplan" / "io" / "scenario.schema.json").read_text())


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_knows_commands_options_and_names(capsys, shell, tmp_path):
    pytest.importorskip("shtab")
    status, out = said(capsys, "completion", shell)
    assert status == 0
    for word in ("assess", "--time-limit", "projected-sos", "rrt", "persistent"):
        assert word in out
    if shell == "bash" and shutil.which("bash"):
        script = tmp_path / "complete.sh"
        script.write_text(out + '\nCOMP_WORDS=(riskplan ass); COMP_CWORD=1; _shtab_riskplan; echo "${COMPREPLY[@]}"\n')
        done = subprocess.run(["bash", script], capture_output=True, text=True, check=False, timeout=20)
        assert done.stdout.split() == ["assess"]


@pytest.mark.parametrize("name", ["chromium-headless-shell", "google-chrome"])
def test_doctor_and_pictures_find_the_same_browser(tmp_path, monkeypatch, capsys, name):
    from riskplan.doctor import BROWSER_VARIABLE
    from riskplan.pictures import browser

    monkeypatch.delenv(BROWSER_VARIABLE, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / name).touch(0o755)
    (found,) = [c["found"] for c in json.loads(said(capsys, "doctor", "--json")[1])["checks"] if c["name"] == "browser"]
    assert found == browser.need() == str(tmp_path / name)


def test_doctor_tells_what_is_missing_and_how_to_get_it(capsys, monkeypatch):
    import riskplan.doctor

    found = riskplan.doctor.find_spec
    monkeypatch.setattr(riskplan.doctor, "find_spec", lambda name: None if name == "joblib" else found(name))
    status, out = said(capsys, "doctor")
    assert status == 0
    assert "pip install '.[batch]' in the checkout" in out and "riskplan batch: without joblib" in out
    monkeypatch.setattr(riskplan.doctor, "find_spec", lambda name: None if name == "ompl" else found(name))
    monkeypatch.setattr(riskplan.doctor, "_writable", lambda folder: folder is None)
    status, out = said(capsys, "doctor", "--json")
    checks = {c["name"]: c for c in json.loads(out)["checks"]}
    assert (status, checks["ompl"]["ok"], checks["kernel cache"]["ok"], checks["numpy"]["ok"]) == (
        1,
        False,
        False,
        True,
    )
    assert "NUMBA_CACHE_DIR" in checks["kernel cache"]["advice"]


def test_version_names_what_numbers_depend_on(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    out = capsys.readouterr().out
    assert (
        out.startswith(f"riskplan {rp.__version__} (python ")
        and f"numpy {np.__version__}" in out
        and "ompl 2.0.1" in out
    )


def test_no_module_hides_a_public_name():
    """A submodule, once imported, is an attribute of the package: it must not be called like a function."""
    package = Path(rp.__file__).parent
    modules = {p.stem for p in package.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()}
    assert modules & set(rp.__all__) == {"ompl"}
