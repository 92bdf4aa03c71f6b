"""Runs of the suite made several at once: the same tables, whatever ends a run, a worker or the job itself."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import psutil
import pytest
from distributed import Client, LocalCluster
from omegaconf import OmegaConf
from rich.console import Console

from ablations.suite import cluster
from ablations.suite.cluster import StoppedRunError, make_runs_ahead, runnable, worker_count
from ablations.suite.descriptions import read_experiment
from ablations.suite.plan import PlannedRun, RunSpec
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import read_records
from gaussian_enhancer.runs.status import State
from support.job_config import initialised
from support.tiny_suite import TINY, configured, content, plan, started

LONG = "['settings.steps=1000000','scene.height=32','scene.width=48','scene.views=8','settings.init=random']"


def step(name: str, minutes: float = 1.0, inputs: tuple[str, ...] = (), digest: str = "0") -> PlannedRun:
    return PlannedRun(RunSpec("fit", "t"), digest, name, State("not started"), inputs, minutes, "", ("t",))


def working(folder: Path) -> set[int]:
    """The processes that work on a run, as its mark names them."""
    found = set()
    for mark in folder.glob("runs/*/*/running"):
        try:
            found.add(int(json.loads(mark.read_text())["pid"]))
        except FileNotFoundError:  # the run was finished between the two
            continue
    return found


def gone(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def wait_for(condition: Callable[[], Any]) -> Any:
    """What a condition finds as soon as it finds something; the test's time limit ends the waiting for nothing."""
    while not (found := condition()):
        time.sleep(0.01)
    return found


def test_what_cannot_be_configured_and_what_needs_it_is_left_alone() -> None:
    done = replace(step("done"), state=State("done"))
    unknown, needing = step("unknown", digest=""), step("needing", inputs=("unknown",))
    free = step("free", inputs=("done",))
    assert runnable([done, unknown, needing, free]) == [free]


@pytest.mark.parametrize("count", [0, -1, 1.5, "two"])
def test_the_number_of_workers_is_positive(count, tmp_path, monkeypatch) -> None:
    with pytest.raises(InputError, match=r"workers: is .*; give a positive number or null"):
        worker_count(OmegaConf.create({"workers": count}))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="workers"):
        started("table=10", f"workers={count}")
    assert list(tmp_path.iterdir()) == []


def test_there_is_a_worker_a_core_but_few_and_one_beside_a_gpu(monkeypatch) -> None:
    def count(cores: int, device: str) -> int:
        monkeypatch.setattr(cluster, "usable_cores", lambda: cores)
        monkeypatch.setattr(cluster, "choose_device", lambda _: OmegaConf.create({"type": device}))
        return worker_count(OmegaConf.create({"workers": None, "runtime": {"device": "auto"}}))

    assert [count(cores, "cpu") for cores in (1, 2, 64)] == [1, 2, cluster.MAX_WORKERS]
    assert count(64, "cuda") == 1


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    """A scheduler with two workers in this process."""
    how = {"threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with LocalCluster(n_workers=2, **how) as local, Client(local) as one:
        yield one


def ahead(make: Callable[..., None], client: Client, monkeypatch) -> dict[str, Exception]:
    """What goes wrong with table 10 where runs are made by a function."""
    monkeypatch.setattr(cluster, "_make", make)
    cfg = configured("table=10", "workers=2", f"scheduler={client.scheduler.address}")
    with initialised():
        return make_runs_ahead(cfg, [read_experiment("table_10", cfg.scale)], Console(quiet=True))


def test_every_run_is_made_once_after_its_inputs(client, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    log = tmp_path / "made"

    def make(settings: object, work: RunSpec, digest: str, inputs: object) -> None:
        with log.open("a") as file:
            file.write(f"{digest}\n")

    assert ahead(make, client, monkeypatch) == {}
    made = log.read_text().splitlines()
    steps = plan("table=10")
    digests = {step.name: step.digest for step in steps}
    assert sorted(made) == sorted(digests.values())
    for step in steps:
        assert all(made.index(digests[name]) < made.index(step.digest) for name in step.inputs)


def test_a_run_that_the_user_stops_stops_the_job(client, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)

    def stopped(*_: object) -> None:
        raise StoppedRunError

    with pytest.raises(KeyboardInterrupt):
        ahead(stopped, client, monkeypatch)


def test_what_needs_a_failed_run_is_not_tried(client, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    log = tmp_path / "tried"

    def full(settings: object, work: RunSpec, digest: str, inputs: object) -> None:
        with log.open("a") as file:
            file.write(f"{work.job}\n")
        raise ValueError("full")

    failures = ahead(full, client, monkeypatch)
    assert log.read_text().splitlines() == ["fit"] * 3
    assert {str(one) for one in failures.values()} == {"full"}
    assert set(failures) == {step.digest for step in plan("table=10") if step.work.job == "fit"}


def test_a_run_whose_worker_is_killed_is_made_again(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    log = tmp_path / "begun"

    def dying(settings: object, work: RunSpec, digest: str, inputs: object) -> None:
        first = not log.exists()
        with log.open("a") as file:
            file.write(f"{digest}\n")
        if first:
            os.kill(os.getpid(), signal.SIGKILL)

    how = {"threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with LocalCluster(n_workers=1, **how) as local, Client(local) as own:
        assert ahead(dying, own, monkeypatch) == {}
    begun = log.read_text().splitlines()
    times = Counter(begun)
    assert times.pop(begun[0]) == 2  # the run of the worker that was killed
    assert set(times.values()) == {1}
    assert {begun[0], *times} == {step.digest for step in plan("table=10")}


def test_two_jobs_at_one_scheduler_make_a_run_once(client, tmp_path, monkeypatch) -> None:
    log = tmp_path / "made"

    def make(settings: object, work: RunSpec, digest: str, inputs: object) -> None:
        time.sleep(0.1)
        with log.open("a") as file:
            file.write(f"{digest}\n")

    monkeypatch.setattr(cluster, "_make", make)
    steps = [step(name, digest=f"{tmp_path.name}-{name}") for name in "abc"]
    with Client(client.scheduler.address, set_as_default=False) as other:
        futures = [cluster.submit_runs(one, steps, {}) for one in (client, other)]
        for own in futures:
            for future in own.values():
                future.result()
    assert sorted(log.read_text().splitlines()) == [one.digest for one in steps]


def test_a_scheduler_that_does_not_answer_is_a_users_mistake(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cluster, "Client", partial(Client, set_as_default=False))
    cfg = configured("table=10", "scheduler=tcp://127.0.0.1:9")
    with initialised(), pytest.raises(InputError, match="does not answer"):
        make_runs_ahead(cfg, [read_experiment("table_10", cfg.scale)], Console(quiet=True))


@pytest.mark.slow
def test_two_workers_make_the_tables_of_one(made, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    started("table=10", "workers=2")
    told = capsys.readouterr().err
    assert all(f"{number} of 21: " in told for number in range(1, 22))
    assert content(tmp_path) == content(made)
    for name in ("table_10.json", "table_10.csv"):
        assert (tmp_path / "results/tiny" / name).read_bytes() == (made / "results/tiny" / name).read_bytes()
    done = [{path.relative_to(root) for path in root.glob("runs/*/*/done")} for root in (tmp_path, made)]
    assert done[0] == done[1]


@pytest.mark.slow
def test_a_run_that_fails_is_told_once_and_what_needs_it_is_missing_with_its_reason(copied, made, capsys) -> None:
    (training,) = [one for one in plan("table=10") if one.work.job == "train" and one.work.method == "ge"]
    shutil.rmtree(copied / "runs/train" / training.name)
    (copied / "runs/train" / training.name).write_text("a file where the run's folder should be")
    for method in ("ge", "ge_ssif"):
        (folder,) = copied.glob(f"runs/row/object-2dgs-{method}-*")
        shutil.rmtree(folder)
    started("table=10", "workers=2")
    told = [line for line in capsys.readouterr().err.splitlines() if line]
    ended = [line.split(": ")[1] for line in told if " of 3: " in line]
    assert sorted(name.split("-")[0] for name in ended) == ["row object", "row object", "train ge"]
    reason = f"runs/train/{training.name}: cannot be written"
    assert [reason in entry[7]["row"] for entry in content(copied) if entry[3] == "ge"] == [True]
    assert sum(reason in line for line in told) == 2  # as it fails, and as its method is missing
    assert {r.kind for r in read_records(copied / "results/tiny/table_10.jsonl") if r.variant != "ge"} == {"quality"}
    assert [one for one in content(copied) if one[3] != "ge"] == [one for one in content(made) if one[3] != "ge"]


@pytest.mark.slow
def test_a_worker_that_is_killed_does_not_lose_the_job(copied, made, capsys) -> None:
    for one in plan("table=10"):
        if one.work.method in ("ge", "gepp"):
            shutil.rmtree(copied / "runs" / one.work.job / one.name)
    killed: list[int] = []

    def kill() -> None:
        def at_work() -> set[int]:
            return working(copied) & {child.pid for child in psutil.Process().children(recursive=True)}

        killed.extend(wait_for(at_work))
        psutil.Process(killed[0]).send_signal(signal.SIGKILL)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    started("table=10", "workers=2")
    killer.join()
    assert "12 of 12" not in capsys.readouterr().err  # only what was missing is made
    assert gone(killed[0])
    assert content(copied) == content(made)
    assert {one.state.name for one in plan("table=10")} == {"done"}


@pytest.mark.slow
def test_workers_end_with_a_job_that_is_killed(tmp_path) -> None:
    command = [sys.executable, "-c", "from gaussian_enhancer.cli.main import main; main()", "tables", "table=10"]
    options = [*TINY, "workers=2", f"scale.fit={LONG}"]
    job = subprocess.Popen([*command, *options], cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        found = wait_for(lambda: both if len(both := working(tmp_path)) == 2 or job.poll() is not None else None)
        assert job.poll() is None
        assert job.pid not in found
    finally:
        job.send_signal(signal.SIGKILL)
        job.wait()
    try:
        wait_for(lambda: all(map(gone, found)))
    finally:
        for pid in found:
            if not gone(pid):
                psutil.Process(pid).kill()
