"""Bad inputs for every reader, each case in a worker process with limits of processor time and memory.

    python tests/fuzz/campaign.py --cases 1200 --record docs/results/fuzz.jsonl

Verdicts: "refused" (an `InputError` of one line with a remedy), "right" (read, and all that must hold does), "wrong"
(read, but something does not hold, or the damage had to be refused), "crashed" (any other error, too long, too large,
or the process ended).
"""

import argparse
import json
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

SECONDS = 20
"""Processor time that a case may take, whatever else the machine does."""
PATIENCE = 900
"""Seconds after which a worker that does not answer counts as hanging."""
GROWTH_MB = 400
"""Memory that a case may take: many times what any of the small files needs."""
TESTS = Path(__file__).resolve().parents[1]
FOLDERS = (".", "scene", "splat/io", "network")


def cases(count: int, names: list[str]) -> Iterator[tuple[str, int]]:
    """Readers in turn, with the number of each one's case."""
    for index in range(count):
        yield names[index % len(names)], index // len(names)


def run(count: int, names: list[str] | None = None) -> list[dict[str, Any]]:
    """The record of each case."""
    worker, found = _Worker(), []
    try:
        for name, seed in cases(count, names or worker.names):
            found.append({"reader": name, "seed": seed, **worker.verdict(name, seed)})
    finally:
        worker.stop()
    return found


class _Worker:
    """A process that judges one case after another, and is replaced when it ends or takes too long."""

    def __init__(self) -> None:
        self.process: Any = None
        self.names: list[str] = []
        self._start()

    def verdict(self, name: str, seed: int) -> dict[str, Any]:
        self.process.stdin.write(json.dumps([name, seed]) + "\n")
        self.process.stdin.flush()
        try:
            return self._answer(PATIENCE)
        except (TimeoutError, ValueError) as error:
            self.stop()
            self._start()
            return {"verdict": "crashed", "way": "", "detail": str(error)}

    def stop(self) -> None:
        self.process.kill()
        self.process.wait()

    def _start(self) -> None:
        command = [sys.executable, str(Path(__file__).resolve()), "--worker"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.names = self._answer(PATIENCE)

    def _answer(self, seconds: float) -> Any:
        if not select.select([self.process.stdout], [], [], seconds)[0]:
            raise TimeoutError(f"took more than {seconds} s")
        line = self.process.stdout.readline()
        if not line:
            raise ValueError(f"the process ended with {self.process.wait()}")
        return json.loads(line)


def work() -> None:
    """Answer cases from standard input."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a codec prints does not mix with the answers
    sys.path[:0] = [str(TESTS / folder) for folder in FOLDERS]
    import torch

    from fuzz.readers import READERS

    torch.set_num_threads(1)
    _limit_memory()
    folder = Path(tempfile.mkdtemp())
    try:
        for name, reader in READERS.items():
            (folder / "whole" / name).mkdir(parents=True)
            reader.make(folder / "whole" / name)
            whole = reader.faults(reader.read(folder / "whole" / name))
            assert not whole, (name, whole)
        print(json.dumps(list(READERS)), file=answers, flush=True)
        for line in sys.stdin:
            name, seed = json.loads(line)
            print(json.dumps(_judge(READERS[name], folder / "whole" / name, folder / "case", f"{name}/{seed}")),
                  file=answers, flush=True)  # fmt: skip
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _judge(reader: Any, whole: Path, case: Path, seed: str) -> dict[str, Any]:
    from fuzz.readers import damaged
    from gaussian_enhancer.errors import InputError

    shutil.rmtree(case, ignore_errors=True)
    shutil.copytree(whole, case)
    way, must = damaged(reader, case, seed)
    told = {"way": way}
    before = _peak_mb()
    try:
        with _time_limit():
            faults = reader.faults(reader.read(case))
    except InputError as error:
        line = str(error)
        tidy = line.count("\n") == 0 and line.isprintable() and "; " in line and "fit into memory" not in line
        verdict = {"verdict": "refused" if tidy else "crashed", "detail": line.replace(str(case), "")[:300]}
    except BaseException as error:
        verdict = {"verdict": "crashed", "detail": f"{type(error).__name__}: {error}"[:300]}
    else:
        faults = faults or (["had to be refused"] if must else [])
        verdict = {"verdict": "wrong" if faults else "right", "detail": ", ".join(faults)[:300]}
    if _peak_mb() - before > GROWTH_MB:
        verdict = {"verdict": "crashed", "detail": f"took {_peak_mb() - before:.0f} MB"}
    return {**told, **verdict}


@contextmanager
def _time_limit() -> Iterator[None]:
    def late(*_: Any) -> None:
        raise TimeoutError(f"took more than {SECONDS} s of processor time")

    signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _limit_memory() -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 4 * 2**30, resource.RLIM_INFINITY))


def summary(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Counts of verdicts by reader and way of damage, and every case that did not end well; the first is the total."""
    # Imported here: the fuzzer that is guided by coverage imports this module before it watches what is imported.
    from gaussian_enhancer.metrics.provenance import provenance

    verdicts = Counter((r["reader"], r["way"].split(": ")[-1], r["verdict"]) for r in records)
    rows: list[dict[str, Any]] = [
        {"reader": reader, "way": way, "verdict": verdict, "cases": count}
        for (reader, way, verdict), count in sorted(verdicts.items())
    ]
    bad = [{"case": f"{r['reader']}/{r['seed']}", **r} for r in records if r["verdict"] in ("wrong", "crashed")]
    total = {"total": len(records), **Counter(r["verdict"] for r in records), **provenance(timed=True)}
    return [total, *rows, *bad]


def main() -> None:
    """Run the campaign, write its record, and fail where a case ended badly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worker", action="store_true")
    parser.add_argument("--cases", type=int, default=1200)
    parser.add_argument("--readers", nargs="*")
    parser.add_argument("--record", type=Path)
    options = parser.parse_args()
    if options.worker:
        work()
        return
    rows = summary(run(options.cases, options.readers))
    if options.record:
        options.record.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    print(json.dumps(rows[0]))
    bad = [row for row in rows if "case" in row]
    for row in bad[:60]:
        print(json.dumps(row))
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
