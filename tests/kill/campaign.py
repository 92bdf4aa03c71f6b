"""Jobs that are killed, doubled or left without room on the disk, and what the same command makes of it afterwards.

    python tests/kill/campaign.py --moments 100 --record docs/results/kill.jsonl

Every job runs once undisturbed; its result is what the others must come to. The cases:

- kill: a signal at a seeded moment, then the same command again. Half of the moments are writes, counted by audit
  events, so that they are the same on every machine; the others are shares of the processor's time that it takes.
- two processes: one is stopped in the middle of its writes, another begins in the same folder, the first goes on.
- full disk: from one write onwards no file grows any more, then the same command again with room.

A record that is there already is gone on with: cases that were handled are not done again.

Verdicts: "handled" or "failed". A case fails where a file that can be seen is cut, a run is marked as done that is not,
the command ends in a traceback, or the result in the end is not equal: bit for bit, but for times.
"""

import argparse
import fcntl
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parents[1]
ROOM = 1 << 20
"""Bytes of a process's output that are kept."""
LONGEST = 600
SIGNALS = ("SIGKILL", "SIGTERM", "SIGINT")
SHARES = {"fit": 32, "train": 28, "enhance": 28, "tables": 12, "video": 20, "distil": 20}
"""Kills by job, in percent of ``--moments``."""


# Processes -------------------------------------------------------------------------------------------------------


@dataclass
class Started:
    """A job's process.

    Args:
        pid: its number.
        output: what it prints, a pipe.
        begun: when it began.
        log: its writes.
        used: seconds of processor, once it has ended.
    """

    pid: int
    output: int
    begun: float
    log: Path
    used: float = 0.0


@dataclass(frozen=True)
class Ended:
    """How a process ended: exit code, or the negative number of a signal; what it printed; seconds of processor."""

    code: int
    printed: str
    seconds: float


def start(words: tuple[str, ...], folder: Path, at: int | None = None, action: str = "") -> Started:
    """Begin a job in a folder, in a copy of this process, which has imported all that jobs need."""
    from kill.moments import watch

    log = folder.parent / f"{folder.name}-{time.monotonic_ns()}.log"
    receiving, sending = os.pipe()
    fcntl.fcntl(sending, fcntl.F_SETPIPE_SZ, ROOM)
    pid = os.fork()
    if pid:
        os.close(sending)
        os.set_blocking(receiving, False)
        return Started(pid, receiving, time.monotonic(), log)
    os.chdir(folder)
    os.dup2(sending, 1)
    os.dup2(sending, 2)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    watch(log, at, action)
    os._exit(_work(words))


def _work(words: tuple[str, ...]) -> int:
    """Run a job as its program does; the exit code."""
    from gaussian_enhancer.cli.main import main

    code = 0
    try:
        main(words)
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    return code


def wait(process: Started) -> Ended:
    """Wait for the end; a process that takes too long is killed."""
    while (code := _code(process)) is None:
        if time.monotonic() - process.begun > LONGEST:
            os.kill(process.pid, signal.SIGKILL)
        time.sleep(0.02)
    printed = b""
    while chunk := os.read(process.output, ROOM):
        printed += chunk
    os.close(process.output)
    return Ended(code, printed.decode(errors="replace"), process.used)


def _code(process: Started) -> int | None:
    pid, status, usage = os.wait4(process.pid, os.WNOHANG)
    if not pid:
        return None
    process.used = usage.ru_utime + usage.ru_stime
    return os.waitstatus_to_exitcode(status)


def used(process: Started) -> float:
    """Seconds of processor that a process has used so far."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def writes(process: Started) -> list[str]:
    return [line for line in process.log.read_text().splitlines() if line != "flock"]


# Cases -----------------------------------------------------------------------------------------------------------


class Campaign:
    """Cases of one job, and its undisturbed result.

    Args:
        name: the job's.
        root: a folder for everything.
    """

    def __init__(self, name: str, root: Path) -> None:
        from kill.jobs import JOBS, result

        self.name, self.job, self.root, self.count = name, JOBS[name], root, 0
        for _ in range(2):  # the first may compile kernels and leave them in their cache
            folder = self.folder()
            process = start(self.job.words, folder)
            ended = wait(process)
            if ended.code != 0:
                raise RuntimeError(f"{name} undisturbed ends with {ended.code}:\n{ended.printed}")
            self.whole, self.writes, self.seconds = result(folder), writes(process), ended.seconds
            self.done(folder)

    def folder(self) -> Path:
        """A new folder with the job's inputs."""
        self.count += 1
        folder = self.root / f"{self.name}-{self.count}"
        folder.mkdir(parents=True)
        self.job.make(folder)
        return folder

    def done(self, folder: Path) -> None:
        shutil.rmtree(folder)
        for log in self.root.glob("*.log"):
            log.unlink()

    def killed_at_write(self, number: int, name: str) -> dict[str, Any]:
        """The signal comes just before a write."""
        folder = self.folder()
        process = start(self.job.words, folder, number, name)
        record = self.again(folder, wait(process))
        return self.row("kill", name, f"write {number + 1} of {len(self.writes)}", record)

    def killed_after(self, share: float, name: str) -> dict[str, Any]:
        """The signal comes after a share of the processor's time, wherever the process is then."""
        folder = self.folder()
        process = start(self.job.words, folder)
        while (running := not _ended_yet(process)) and used(process) < share * self.seconds:
            time.sleep(0.005)
        if running:
            os.kill(process.pid, signal.Signals[name])
        return self.row("kill", name, f"{share:.0%} of the time", self.again(folder, wait(process), running))

    def disk_full(self, number: int) -> dict[str, Any]:
        """No file grows any more from a write on; whatever is refused is refused in one line."""
        from kill.moments import FULL

        folder = self.folder()
        ended = wait(start(self.job.words, folder, number, FULL))
        lines = [line for line in ended.printed.splitlines() if line.startswith("gaussian-enhancer: ")]
        faults = []
        if ended.code not in (0, 2) or (ended.code == 2 and len(lines) != 1):
            faults = [f"ends with {ended.code}: {ended.printed.strip()[-300:]}"]
        record = self.again(folder, ended, faults=faults)
        record["how"] = "refused in one line, then equal" if ended.code == 2 else "went on without it, equal"
        return self.row("full disk", FULL, _kind(self.writes[number]), record)

    def two(self, words: tuple[str, ...] = ()) -> dict[str, Any]:
        """Another process begins while the first is in the middle of its writes.

        Args:
            words: more words of the other's command; none: the same command.
        """
        output = ("output=out",) if words else ()
        number = len(self.writes) // 2
        while True:
            folder = self.folder()
            first = start((*self.job.words, *output), folder, number, "SIGSTOP")
            os.waitid(os.P_PID, first.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
            if not _ended_yet(first) or number == 1:
                break
            wait(first)  # with output= there are fewer writes
            self.done(folder)
            number //= 2
        second = start((*self.job.words, *output, *words), folder)
        how = _waits(second)
        os.kill(first.pid, signal.SIGCONT)
        ended, other = wait(first), wait(second)
        faults = [] if ended.code == 0 else [f"the first ends with {ended.code}: {ended.printed.strip()[-300:]}"]
        if other.code not in (0, 2) or "Traceback" in other.printed:
            faults.append(f"the second ends with {other.code}: {other.printed.strip()[-300:]}")
        if how == "works" and other.code == 0:
            faults.append("both worked in one folder at once")
        if words and how == "waits" and other.code == 0:
            faults.append("both ended well, with different results in one folder")
        told = "waited" if how == "waits" else "refused" if other.code == 2 else "worked"
        record = self.judged(folder, faults, equal=not words)
        return self.row(
            "two processes", "another command" if words else "the same command", "", {**record, "how": told}
        )

    def again(
        self, folder: Path, ended: Ended, disturbed: bool = True, faults: list[str] | None = None
    ) -> dict[str, Any]:
        """What a disturbed process left, and what the same command makes of it.

        Args:
            folder: where it worked.
            ended: how it ended.
            disturbed: whether it was disturbed before it ended.
            faults: what was wrong before.
        """
        from kill.jobs import cut, early

        faults = [*(faults or ()), *cut(folder)]
        faults += [f"{name} of a finished run differs" for name in early(folder, self.whole)]
        if "Traceback (most recent call last)" in ended.printed:
            faults.append(f"ends in a traceback: {ended.printed.strip()[-300:]}")
        second = wait(start(self.job.words, folder))
        if second.code != 0:
            faults.append(f"the same command ends with {second.code}: {second.printed.strip()[-300:]}")
        how = "the same command, equal" if disturbed else "ended before"
        return {"how": how, **self.judged(folder, faults)}

    def judged(self, folder: Path, faults: list[str], equal: bool = True) -> dict[str, Any]:
        """The verdict on what lies in a folder in the end, which is removed."""
        from kill.jobs import cut, differences, result

        faults = [*faults, *cut(folder)]
        if equal and not faults:
            faults += [f"{name} differs" for name in differences(self.whole, result(folder))]
        self.done(folder)
        return {"verdict": "failed" if faults else "handled", **({"detail": "; ".join(faults[:4])} if faults else {})}

    def row(self, kind: str, action: str, moment: str, record: dict[str, Any]) -> dict[str, Any]:
        """A line of the record."""
        return {"class": kind, "job": self.name, "signal": action, "moment": moment, **record}


def _ended_yet(process: Started) -> bool:
    """Whether a process has ended; it can still be waited for."""
    return os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _waits(process: Started, polls: int = 20) -> str:
    """Whether a process ends by itself ("works", also for a refusal) or asks for a lock again and again ("waits")."""
    while not _ended_yet(process):
        log = process.log.read_text() if process.log.is_file() else ""
        asked = re.search(rf"(flock\n|[a-z.]+ .*lock.*\n){{{polls}}}\Z", log)
        if asked or time.monotonic() - process.begun > LONGEST / 2:
            return "waits"
        time.sleep(0.1)
    return "works"


def _kind(write: str) -> str:
    """What sort of file a write is of: its path without numbers, hashes and the names of a suite's runs."""
    name = re.sub(r"/\.([^/]*?)\.[a-z0-9_]{8}(\.[^./]*)?$", r"/\1\2", "/" + write.partition(" ")[2])
    name = re.sub(r"-[0-9a-f]{8,12}\b", "", re.sub(r"(?<![a-z])\d+(?=[./]|$)|_\d+", "#", name))[1:]
    return re.sub(r"^runs/(\w+)/[^/]+/", r"runs/\1/*/", name)


def kinds(lines: list[str]) -> list[int]:
    """The number of the first write of every sort of file."""
    first: dict[str, int] = {}
    for number, line in enumerate(lines):
        if line.startswith("open "):
            first.setdefault(_kind(line), number)
    return sorted(first.values())


Case = tuple[str, Callable[["Campaign"], dict[str, Any]]]


def kills(name: str, count: int, seed: int = 0) -> Iterator[Case]:
    """Kills of a job at seeded moments, each with a name."""
    draw = random.Random(f"{name} {seed}")
    for number in range(count):
        sent, share = SIGNALS[number % len(SIGNALS)], round(draw.uniform(0.02, 0.98), 3)
        if number % 2:
            yield f"kill {number}", lambda campaign, share=share, sent=sent: campaign.killed_after(share, sent)
        else:
            yield (
                f"kill {number}",
                lambda campaign, share=share, sent=sent: campaign.killed_at_write(
                    int(share * len(campaign.writes)), sent
                ),
            )


def others(campaign: "Campaign") -> Iterator[Case]:
    """Two processes in one folder, and a full disk at every sort of file that the job writes."""
    yield "two", lambda campaign: campaign.two()
    if campaign.job.other:
        yield "two others", lambda campaign: campaign.two(campaign.job.other)
    for number in kinds(campaign.writes):
        yield f"full {_kind(campaign.writes[number])}", lambda campaign, number=number: campaign.disk_full(number)


def run(names: list[str], moments: int, record: Path | None, root: Path) -> list[dict[str, Any]]:
    """The record of every case, written as they come; those that a record holds are not done again."""
    from gaussian_enhancer.metrics.provenance import provenance

    held = [json.loads(line) for line in record.read_text().splitlines()] if record and record.is_file() else []
    rows = [row for row in held if row.get("verdict") == "handled"]
    for name in names:
        campaign = Campaign(name, root)
        print(f"{name}: {campaign.seconds:.1f} s, {len(campaign.writes)} writes", file=sys.stderr, flush=True)
        known = {row["case"] for row in rows if row["job"] == name}
        for case, judge in (*kills(name, moments * SHARES[name] // 100), *others(campaign)):
            if case in known:
                continue
            rows.append({"case": case, **judge(campaign), **provenance(timed=True)})
            print(json.dumps(rows[-1]), flush=True)
            if record:
                lines = (json.dumps(row) + "\n" for row in (summary(rows), *rows))
                record.write_text("".join(lines), encoding="utf-8")
    return rows


def slice_of_all(root: Path) -> list[dict[str, Any]]:
    """A few cases of the quickest job, at moments that do not depend on the machine's speed."""
    campaign = Campaign("fit", root)
    last = len(campaign.writes) - 1
    moments = ((last // 4, "SIGKILL"), (last // 2, "SIGTERM"), (3 * last // 4, "SIGINT"), (last, "SIGKILL"))
    found = [campaign.killed_at_write(number, name) for number, name in moments]
    return [*found, campaign.disk_full(kinds(campaign.writes)[-1])]


# Record ----------------------------------------------------------------------------------------------------------


def imported() -> None:
    """Import what jobs import, so that each need not."""
    import importlib
    import pkgutil

    import torch
    from hydra.core.plugins import Plugins

    import ablations
    import gaussian_enhancer

    for package in (gaussian_enhancer, ablations):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not re.search(r"__main__|benchmarks|scripts|gsplat|\.pages$", module.name):
                importlib.import_module(module.name)
    for name in ("lightning.pytorch.loggers", "pycolmap", "kill.jobs"):
        importlib.import_module(name)
    Plugins.instance()
    torch.set_num_threads(1)


def summary(records: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts of verdicts."""
    return {"total": len(records), **Counter(record["verdict"] for record in records)}


def main() -> None:
    """Run the campaign, write its record, and fail where a case ended badly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=100, help="kills; each job has its share")
    parser.add_argument("--jobs", nargs="*", default=list(SHARES))
    parser.add_argument("--slice", action="store_true", help="the few cases that run with the tests")
    parser.add_argument("--record", type=Path)
    options = parser.parse_args()
    if os.environ.get("OMP_NUM_THREADS") != "1":  # read when torch is loaded; one thread is the same everywhere
        threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        ended = subprocess.run([sys.executable, *sys.argv], env={**os.environ, **threads}, check=False)
        sys.exit(ended.returncode)
    sys.path.insert(0, str(TESTS))
    imported()
    with tempfile.TemporaryDirectory() as folder:
        if options.slice:
            rows = slice_of_all(Path(folder))
            print("".join(json.dumps(row) + "\n" for row in rows), end="")
        else:
            rows = run(options.jobs, options.moments, options.record, Path(folder))
    print(json.dumps(summary(rows)))
    sys.exit(1 if summary(rows).get("failed") else 0)


if __name__ == "__main__":
    main()
