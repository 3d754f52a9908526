"""The pages: every Python block runs, every command exists, the site builds strictly."""

import importlib.util
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import riskplan as rp
from checkers import checkers
from riskplan.commands import parser

ROOT = Path(__file__).parent.parent
PAGES = sorted((ROOT / "docs").glob("*.md"))
NEEDS = {"batch.md": "pyarrow"}


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), flags=re.DOTALL)


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=lambda p: p.name)
def test_python_blocks_run_in_order(page, tmp_path):
    if page.name in NEEDS:
        pytest.importorskip(NEEDS[page.name])
    script = tmp_path / f"{page.stem.replace('-', '_')}_page.py"  # a file: numba keeps kernels beside it
    script.write_text("\n".join(blocks(page, "python")))
    runpy.run_path(str(script), run_name="__page__")


def test_the_scenario_shown_can_be_planned(tmp_path):
    (shown,) = [b for b in blocks(ROOT / "docs" / "index.md", "yaml") if not b.startswith("#")]
    (tmp_path / "scene.yaml").write_text(shown)
    assert rp.plan(rp.load_scenario(tmp_path / "scene.yaml"), bound=0.01, time_limit=20.0).solved


@pytest.mark.parametrize("page", ["add-backend.md", "add-vehicle.md"])
def test_what_is_added_may_be_typed_at_a_prompt(page):
    code = "\n".join(blocks(ROOT / "docs" / page, "python"))
    exec(compile(code, "<stdin>", "exec"), {"__name__": "__page__"})


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_commands_exist(page):
    known = parser()
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    lines += re.findall(r"`(riskplan [a-z][^`|>]*?)(?: >[^`]*)?`", page.read_text())
    for line in lines:
        words = shlex.split(line.replace('eval "$(', "").replace(')"', ""))
        if words[:1] != ["riskplan"]:
            continue
        command = words[1]
        (commands,) = [a.choices for a in known._actions if a.dest == "command"]
        if not command.startswith("-"):
            assert command in commands, line
        options = {o for a in commands.get(command, known)._actions for o in a.option_strings}
        assert {w.partition("=")[0] for w in words[2:] if w.startswith("--")} <= options, line
    for module in re.findall(r"python -m ([a-z_.0-9]+)", page.read_text()):
        assert importlib.util.find_spec(module), module


def test_pages_name_backends_that_there_are():
    named = set(re.findall(r"\(`([a-z-]+)`(?:, `([a-z-]+)`)?\)", (ROOT / "docs" / "mathematics.md").read_text()))
    assert {name for pair in named for name in pair if name} == set(checkers()) - {"cascade", "monte-carlo"}
    for name in re.findall(r"\| `([a-z-]+)`", (ROOT / "docs" / "backends.md").read_text()):
        assert name in checkers()


def test_reference_names_what_there_is():
    for path in re.findall(r"::: (\S+)", (ROOT / "docs" / "reference.md").read_text()):
        module, name = path.rsplit(".", 1)
        assert name in rp.__all__
        assert getattr(importlib.import_module(module), name)


@pytest.mark.slow
def test_the_site_builds_strictly(tmp_path):
    pytest.importorskip("mkdocs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "dubins" in (tmp_path / "add-dynamics" / "index.html").read_text() or (tmp_path / "reference").is_dir()
