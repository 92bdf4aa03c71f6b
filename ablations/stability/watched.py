"""The matrix in a process of its own, so that a hang or a crash is a cell and not the end of the job."""

import multiprocessing
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection

import torch

from ablations.stability.case import PRECISIONS, Case, Precision
from ablations.stability.judge import FAILED, CaseOutcome, judged, record_of
from gaussian_enhancer.metrics.records import Record

Task = tuple[Case, Precision, str]


def measured(
    cases: Sequence[Case],
    precisions: Sequence[Precision] = PRECISIONS,
    threads: int = 1,
) -> Iterator[Record]:
    """A record for each case, precision and pass.

    Args:
        cases: importable by name, since another process computes them.
        precisions: columns.
        threads: that the other process computes with.
    """
    left: list[Task] = [(c, p, d) for c in cases for p in precisions for d in c.passes]
    while left:
        worker = _Worker(left, threads)
        try:
            while left:
                case, precision, direction = left[0]
                cell = worker.answer(case.seconds)
                left.pop(0)
                yield record_of(case, precision, direction, cell)
                if not worker.alive:  # the rest is another process's
                    break
        finally:
            worker.end()


class _Worker:
    """A process that computes cells one after the other.

    Started anew, never forked: compiled kernels that have run once do not survive a fork.
    """

    def __init__(self, tasks: Sequence[Task], threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.answers, theirs = context.Pipe(duplex=False)
        self.process = context.Process(target=compute, args=(tuple(tasks), theirs, threads), daemon=True)
        self.process.start()
        theirs.close()
        self.alive = True
        self._expect(600.0)  # imports take a while where the machine is busy

    def answer(self, seconds: float) -> CaseOutcome:
        """The next cell; one that has failed where none comes in time or the process dies."""
        return self._expect(seconds)

    def end(self) -> None:
        """Stop the process."""
        self.process.kill()
        self.process.join()
        self.answers.close()

    def _expect(self, seconds: float) -> CaseOutcome:
        if not self.answers.poll(seconds):
            self.alive = False
            return CaseOutcome(FAILED, f"has no result after {seconds:g} s", seconds=seconds)
        try:
            cell: CaseOutcome = self.answers.recv()
        except EOFError:
            self.process.join()
            self.alive = False
            return CaseOutcome(FAILED, f"ended its process with code {self.process.exitcode}")
        return cell


def compute(tasks: Sequence[Task], answers: Connection, threads: int) -> None:
    """The other process: says that it is there, then sends a cell for each task."""
    torch.set_num_threads(threads)
    answers.send(CaseOutcome(""))
    for case, precision, direction in tasks:
        answers.send(judged(case, precision, direction))
