"""Runs of the suite made several at once: the same tables, whatever ends a run, a worker or the job itself."""

import json
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import psutil
import pytest
from hydra import initialize_config_dir
from omegaconf import OmegaConf
from rich.console import Console

from ablations.suite import workers
from ablations.suite.descriptions import experiment
from ablations.suite.plan import Step, Work
from ablations.suite.workers import made_ahead, next_step, worker_count
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import read_records
from gaussian_enhancer.runs.status import State
from support.tiny_suite import CONF, TINY, configured, content, plan, started

LONG = "['settings.steps=1000000','scene.height=32','scene.width=48','scene.views=8','settings.init=random']"


def step(name: str, minutes: float = 1.0, inputs: tuple[str, ...] = (), digest: str = "0") -> Step:
    return Step(Work("fit", "t"), digest, name, State("not started"), inputs, minutes, "", ("t",))


def order(steps: list[Step]) -> list[str]:
    """The names in the order in which one worker makes them."""
    waiting, made = list(steps), []
    while (one := next_step(waiting, {other.name for other in waiting})) is not None:
        waiting.remove(one)
        made.append(one.name)
    return made


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


def wait_until(condition, seconds: float = 900.0) -> bool:
    ends = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < ends:
        time.sleep(0.01)
    return bool(found)


def test_the_longest_comes_first_and_inputs_before_what_needs_them() -> None:
    steps = [step("row", 9.0, ("fit", "train")), step("train", 5.0, ("fit",)), step("fit", 1.0), step("other", 2.0)]
    assert order(steps) == ["other", "fit", "train", "row"]
    assert order([step("first"), step("second")]) == ["first", "second"]


def test_every_run_comes_after_its_inputs_whatever_they_cost() -> None:
    chance = random.Random(0)
    for _ in range(20):
        names = [str(number) for number in range(12)]
        inputs = {name: tuple(chance.sample(names[:i], chance.randrange(i + 1))) for i, name in enumerate(names)}
        steps = [step(name, chance.random(), inputs[name]) for name in names]
        chance.shuffle(steps)
        made = order(steps)
        assert sorted(made) == sorted(names)
        assert all(made.index(before) < made.index(name) for name in names for before in inputs[name])


def test_what_needs_a_failed_run_or_cannot_be_configured_is_left_alone() -> None:
    needing, unknown, free = step("needing", 9.0, ("failed",)), step("unknown", 8.0, digest=""), step("free")
    waiting = {"needing", "unknown", "free"}
    assert next_step([needing, unknown, free], waiting | {"failed"}) == free
    assert next_step([needing, unknown], waiting | {"failed"}) is None
    assert next_step([needing, unknown], waiting) == needing


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
        monkeypatch.setattr(workers.os, "sched_getaffinity", lambda _: set(range(cores)))
        monkeypatch.setattr(workers, "choose_device", lambda _: OmegaConf.create({"type": device}))
        return worker_count(OmegaConf.create({"workers": None, "runtime": {"device": "auto"}}))

    assert [count(cores, "cpu") for cores in (1, 2, 64)] == [1, 2, workers.MOST]
    assert count(64, "cuda") == 1


class Pool(ProcessPoolExecutor):
    """Processes that answer whatever they are asked with an error, or are not there any more."""

    def __init__(self, error: BaseException, asked: bool) -> None:
        self.error, self.asked, self.steps = error, asked, list[Work]()

    def __enter__(self) -> "Pool":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def submit(self, make: object, settings: object, work: Work) -> Future[None]:
        self.steps.append(work)
        if not self.asked:
            raise self.error
        future = Future[None]()
        future.set_exception(self.error)
        return future


def ahead(pool: Pool, monkeypatch) -> dict[str, Exception]:
    """What goes wrong with table 10 by such processes."""
    monkeypatch.setattr(workers, "ProcessPoolExecutor", lambda *_: pool)
    cfg = configured("table=10", "workers=2")
    with initialize_config_dir(CONF, version_base="1.3"):
        return made_ahead(cfg, [experiment("table_10", cfg.scale)], Console(quiet=True))


@pytest.mark.parametrize("asked", [True, False])
def test_what_broken_processes_leave_is_left_to_the_caller(asked, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert ahead(Pool(BrokenProcessPool("killed"), asked), monkeypatch) == {}


def test_a_run_that_the_user_stops_stops_the_job(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        ahead(Pool(KeyboardInterrupt(), asked=True), monkeypatch)


def test_what_needs_a_failed_run_is_not_tried(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    pool = Pool(ValueError("full"), asked=True)
    failures = ahead(pool, monkeypatch)
    assert [work.job for work in pool.steps] == ["fit"] * 3
    assert {str(one) for one in failures.values()} == {"full"}
    assert set(failures) == {step.digest for step in plan("table=10") if step.work.job == "fit"}


@pytest.mark.slow
def test_two_workers_make_the_tables_of_one(made, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    started("table=10", "workers=2")
    told = capsys.readouterr().err
    assert all(f"{number} of 12: " in told for number in range(1, 13))
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
        (folder,) = copied.glob(f"runs/method/object-2dgs-{method}-*")
        shutil.rmtree(folder)
    started("table=10", "workers=2")
    told = [line for line in capsys.readouterr().err.splitlines() if line]
    ended = [line.split(": ")[1] for line in told if " of 3: " in line]
    assert sorted(name.split("-")[0] for name in ended) == ["row object", "train ge"]
    reason = f"runs/train/{training.name}/config.yaml: cannot be written"
    assert [reason in entry[7]["row"] for entry in content(copied) if entry[3] == "ge"] == [True]
    assert sum(reason in line for line in told) == 2  # as it fails, and as its method is missing
    assert {r.kind for r in read_records(copied / "results/tiny/table_10.jsonl") if r.variant != "ge"} == {"quality"}
    assert [one for one in content(copied) if one[3] != "ge"] == [one for one in content(made) if one[3] != "ge"]


@pytest.mark.timeout(1200)
@pytest.mark.slow
def test_a_worker_that_is_killed_does_not_lose_the_job(copied, made, capsys) -> None:
    for one in plan("table=10"):
        if one.work.method in ("ge", "gepp"):
            shutil.rmtree(copied / "runs" / one.work.job / one.name)
    killed: list[int] = []

    def kill() -> None:
        def at_work() -> set[int]:
            return working(copied) & {child.pid for child in psutil.Process().children()}

        assert wait_until(at_work)
        killed.extend(at_work())
        psutil.Process(killed[0]).send_signal(signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    started("table=10", "workers=2")
    killer.join()
    assert "BrokenProcessPool" in capsys.readouterr().err
    assert gone(killed[0])
    assert content(copied) == content(made)
    assert {one.state.name for one in plan("table=10")} == {"done"}


@pytest.mark.timeout(1200)
@pytest.mark.slow
def test_workers_end_with_a_job_that_is_killed(tmp_path) -> None:
    command = [sys.executable, "-c", "from gaussian_enhancer.cli.main import main; main()", "tables", "table=10"]
    options = [*TINY, "workers=2", f"scale.fit={LONG}"]
    job = subprocess.Popen([*command, *options], cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        assert wait_until(lambda: len(working(tmp_path)) == 2 or job.poll() is not None)
        found = working(tmp_path)
        assert len(found) == 2
        assert job.pid not in found
    finally:
        job.send_signal(signal.SIGKILL)
        job.wait()
    try:
        assert wait_until(lambda: all(map(gone, found)), 60)
    finally:
        for pid in found:
            if not gone(pid):
                psutil.Process(pid).kill()
