"""Batches: nothing lost or repeated by a kill, failures as rows, the same rows whoever computes them."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from test_cli import SMALL

import riskplan as rp
from riskplan.batching import seed_of
from riskplan.batching_child import Children
from riskplan.batching_shards import COLUMNS, claimed, done, schema, write_shard
from riskplan.cli import main

pq = pytest.importorskip("pyarrow.parquet")
pytest.importorskip("joblib")

# the agent stands on the way: no plan is this safe, and the search looks for one to the end
HOPELESS = SMALL.replace(
    "means: [[[30, 3.5], [30, -3.5]], [[30, 3.5], [30, -3.5]]]", "means: [[[8, 0], [8, 0]], [[8, 0], [8, 0]]]"
)
TIMING = ("seconds",)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes")
    for i in range(40):
        (folder / f"{i:02d}.yaml").write_text(SMALL.replace("speed: 10", f"speed: {6 + i / 10}"))
    (folder / "bad.yaml").write_text("version: 1\nstart: [")
    (folder / "deep").mkdir()
    (folder / "deep" / "00.yaml").write_text(SMALL)
    return folder


@pytest.fixture(scope="module")
def undisturbed(source, tmp_path_factory):
    out = tmp_path_factory.mktemp("batch") / "out"
    return rp.batch(source, out, time_limit=20.0, keep_plans=out.parent / "plans", shard_rows=7), out


def rows(out):
    """Row by row without what only the clock decides, by name."""
    table = pq.read_table(out).drop_columns(list(TIMING)).to_pylist()
    return {row["scenario"]: row for row in table}, len(table)


def started(source, out, *more):
    command = [sys.executable, "-m", "riskplan", "batch", str(source), "--out", str(out), "--time-limit", "20"]
    return subprocess.Popen([*command, *more], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_shards(process, out, count):
    deadline = time.monotonic() + 600
    while len(list(out.glob("part-*.parquet"))) < count:
        assert process.poll() is None and time.monotonic() < deadline, process.communicate()
        time.sleep(0.002)


def test_every_scenario_has_one_row_and_failures_say_why(source, undisturbed):
    summary, out = undisturbed
    found, count = rows(out)
    assert count == len(found) == summary.scenarios == 42
    assert (summary.statuses, summary.shards) == ({"solved": 41, "bad_input": 1}, 6)
    assert found["bad.yaml"]["status"] == "bad_input" and "not valid YAML" in found["bad.yaml"]["reason"]
    assert found["bad.yaml"]["risk"] is None
    row = found["deep/00.yaml"]
    alone = rp.plan(rp.load_scenario(source / "deep" / "00.yaml"), time_limit=20.0, seed=seed_of("deep/00.yaml", 0))
    assert row["risk"] == float(alone.risk.total) and row["x"] == alone.poses[:, 0].tolist()
    assert row["times"] == alone.times.tolist() and row["speed"] == alone.speeds.tolist()


def test_killed_and_resumed_is_undisturbed_row_by_row(source, undisturbed, tmp_path):
    out = tmp_path / "out"
    process = started(source, out, "--shard-rows", "1")
    wait_for_shards(process, out, 3)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    (out / ".part-99999999.writing").write_bytes(b"half a shard")
    before = done(out)
    assert 3 <= len(before) < 42
    summary = rp.batch(source, out, time_limit=20.0, shard_rows=7)
    assert (summary.before, sum(summary.statuses.values())) == (len(before), 42 - len(before))
    assert rows(out) == rows(undisturbed[1])
    assert not list(out.glob(".part-*"))
    assert rp.batch(source, out, time_limit=20.0).statuses == {}


# of a shard's write: before its bytes reach the disk, before it has its name, and before the name reaches the disk
KILLED_AT = (("fsync", 1), ("replace", 2), ("fsync", 2), ("replace", 1), ("fsync", 5))
DYING = """
import os, signal, sys
import riskplan.batching_shards as shards
from riskplan.cli import main
wanted, left = sys.argv[1], [int(sys.argv[2])]
class Os:
    def __getattr__(self, name):
        def call(*args):
            left[0] -= name == wanted
            if not left[0]:
                os.kill(os.getpid(), signal.SIGKILL)
            return getattr(os, name)(*args)
        return call if name in ("fsync", "replace") else getattr(os, name)
shards.os = Os()
main(sys.argv[3:])
"""


def test_killed_inside_the_write_of_a_shard(source, undisturbed, tmp_path):
    out, counts = tmp_path / "out", [0]
    for call, nth in KILLED_AT:
        words = ["batch", str(source), "--out", str(out), "--time-limit", "20", "--shard-rows", "3"]
        command = [sys.executable, "-c", DYING, call, str(nth), *words]
        done_by = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
        assert done_by.returncode == -signal.SIGKILL, done_by.stderr
        counts.append(len(done(out)))
    # a shard counts from the moment it has its name
    assert counts == [0, 0, 3, 6, 6, 12]
    rp.batch(source, out, time_limit=20.0, shard_rows=7)
    assert rows(out) == rows(undisturbed[1])


def test_killed_at_random_moments_again_and_again(source, undisturbed, tmp_path):
    out, rng, kills = tmp_path / "out", np.random.default_rng(0), 0
    for attempt in range(6):
        process = started(source, out, "--shard-rows", "2")
        wait_for_shards(process, out, len(list(out.glob("part-*.parquet"))) + 1 + attempt % 2)
        time.sleep(float(rng.uniform(0.0, 0.05)))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        kills += process.returncode == -signal.SIGKILL
        if len(done(out)) > 34:
            break
    assert kills >= 3
    rp.batch(source, out, time_limit=20.0)
    assert rows(out) == rows(undisturbed[1])


def test_interrupt_ends_with_130_and_leaves_shards_that_count(source, tmp_path):
    out = tmp_path / "out"
    process = started(source, out, "--shard-rows", "1")
    wait_for_shards(process, out, 2)
    process.send_signal(signal.SIGINT)
    told, complaint = process.communicate(timeout=300)
    assert (process.returncode, told) == (130, "")
    assert complaint.strip() == "riskplan: interrupted"
    assert 2 <= len(done(out)) < 42


def test_two_workers_give_the_same_rows_and_lists_name_them(source, undisturbed, tmp_path):
    names = ["00.yaml", "07.yaml", "bad.yaml", "deep/00.yaml"]
    listed = source / "list.npz"
    np.savez(listed, scenario=np.array(names))
    rp.batch(listed, tmp_path / "out", time_limit=20.0, workers=2, shard_rows=1)
    found, _ = rows(tmp_path / "out")
    reference, _ = rows(undisturbed[1])
    assert found == {name: reference[name] for name in names}


def test_scoring_judges_the_plans_kept(source, undisturbed, tmp_path):
    out = tmp_path / "out"
    summary = rp.batch(source, out, score=undisturbed[1].parent / "plans", checker="halfspace")
    assert summary.statuses == {"scored": 41, "bad_input": 1}
    found, _ = rows(out)
    planned, _ = rows(undisturbed[1])
    assert "no such file" in found["bad.yaml"]["reason"]
    for name in set(found) - {"bad.yaml"}:
        assert found[name]["stated"] == planned[name]["risk"] <= found[name]["risk"]
        assert found[name]["x"] == planned[name]["x"]


def test_a_scenario_that_takes_too_long_is_a_row(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "hopeless.yaml").write_text(HOPELESS)
    summary = rp.batch(tmp_path / "in", tmp_path / "out", bound=1e-12, time_limit=60.0, limit=1.0)
    assert summary.statuses == {"timed_out": 1}
    assert rows(tmp_path / "out")[0]["hopeless.yaml"]["reason"] == "took more than 1 s"


def test_a_process_that_dies_is_a_reason_and_the_next_one_works(tmp_path):
    path = tmp_path / "hopeless.yaml"
    path.write_text(HOPELESS)
    settings = {"planner": "rrt", "checker": "exact", "bound": 1e-12, "dependence": "independent", "time_limit": 60.0}
    request = {"path": str(path), "problem": 0, "seed": 0, "plan": None, "keep": None, "settings": settings}
    children, answers = Children(), []
    asking = threading.Thread(target=lambda: answers.append(children.ask("rrt", request, 60.0)))
    asking.start()
    while not children._lent:
        time.sleep(0.01)
    (child,) = children._lent
    os.kill(child._process.pid, signal.SIGKILL)
    asking.join(timeout=300)
    assert answers == ["ended by SIGKILL"]
    again = children.ask("rrt", {**request, "settings": {**settings, "time_limit": 0.0}}, 60.0)
    assert again["status"] == "no_plan_found"
    children.close()


def test_children_end_with_their_parent(tmp_path):
    code = "import time; from riskplan.batching_child import Child; "
    code += "c = Child('rrt'); print(c._process.pid, flush=True); time.sleep(60)"
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    pid = int(parent.stdout.readline())
    parent.kill()
    parent.communicate()
    deadline = time.monotonic() + 120
    while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not Path(f"/proc/{pid}").exists()


def test_other_settings_a_second_writer_and_broken_shards_are_refused(source, undisturbed, tmp_path):
    _, out = undisturbed
    with pytest.raises(rp.InputError, match=r"was begun with bound 0.01, got 0.02"):
        rp.batch(source, out, time_limit=20.0, bound=0.02)
    with pytest.raises(rp.InputError, match="no scenarios"):
        rp.batch(tmp_path, tmp_path / "out")
    with claimed(out), pytest.raises(rp.InputError, match="another batch is writing there"):
        rp.batch(source, out, time_limit=20.0)
    row = {"scenario": "a", "status": "solved"}
    write_shard(tmp_path, 0, [row])
    write_shard(tmp_path, 1, [row])
    with pytest.raises(rp.InputError, match=r"part-00000001.parquet: 'a' has a row in an earlier shard too"):
        done(tmp_path)
    (tmp_path / "part-00000000.parquet").write_bytes(b"PAR1")
    with pytest.raises(rp.InputError, match="part-00000000.parquet: not a shard"):
        done(tmp_path)


def test_the_command_prints_one_object(source, undisturbed, capsys):
    command = ["batch", str(source), "--out", str(undisturbed[1]), "--time-limit", "20"]
    assert main([*command, "--json"]) == 0
    told = capsys.readouterr()
    assert (json.loads(told.out)["before"], told.err) == (42, "")
    assert main([*command, "--workers", "0"]) == 2
    assert capsys.readouterr().err == "riskplan: error: workers: expected an integer >= 1, got 0\n"


def test_the_schema_is_the_documented_one(undisturbed):
    assert schema().names == list(COLUMNS)
    table = pq.read_table(undisturbed[1])
    assert table.schema.names == list(COLUMNS)
    assert table.schema.field("risk").metadata[b"meaning"].decode() == COLUMNS["risk"][1]
    text = (Path(__file__).parent.parent / "docs" / "batch.md").read_text()
    for name, (kind, meaning) in COLUMNS.items():
        assert f"| `{name}` | {kind} | {meaning} |" in text


@pytest.mark.slow
def test_a_cluster_gives_the_same_rows(source, undisturbed, tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        rp.batch(source, tmp_path / "out", time_limit=20.0, client=client, shard_rows=5)
    assert rows(tmp_path / "out") == rows(undisturbed[1])
