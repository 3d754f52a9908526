"""What is shipped, and that the README says what is there."""

import subprocess
import sys
import zipfile
from pathlib import Path

import riskplan as rp

ROOT = Path(__file__).parent.parent


def backend_rows():
    return [
        f"| `{name}` | {i.kind.value} | {i.needs} | {i.assumption} | {i.source} | {i.cost} |"
        for name, i in rp.checkers().items()
    ]


def test_readme_lists_the_backends_as_they_declare_themselves():
    text = (ROOT / "README.md").read_text()
    table = [line for line in text.splitlines() if line.startswith("| `") and line.count("|") == 7]
    assert table == backend_rows()


def test_readme_names_every_planner():
    text = (ROOT / "README.md").read_text()
    for name in rp.planners():
        assert f"- `{name}`: " in text


def test_public_names_exist():
    for name in rp.__all__:
        assert getattr(rp, name) is not None


def test_wheel_has_exactly_three_roots_and_its_data(tmp_path):
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)],
        check=True,
        capture_output=True,
        timeout=120,
    )
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {n.split("/")[0] for n in names if ".dist-info" not in n} == {"checkers", "predictor", "riskplan"}
    for wanted in (
        "riskplan/py.typed",
        "checkers/py.typed",
        "predictor/py.typed",
        "riskplan/io/scenario.schema.json",
        "riskplan/data/overtake.yaml",
        "predictor/data/constant_velocity.json",
    ):
        assert wanted in names
    assert not [n for n in names if n.endswith((".nbi", ".nbc", ".pyc"))]
