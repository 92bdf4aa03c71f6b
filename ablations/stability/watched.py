"""Computes the matrix in a separate process, so that a hang or a crash fails one cell and does not end the job."""

import multiprocessing
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection

import torch

from ablations.stability.case import PRECISIONS, Case, Precision
from ablations.stability.judge import FAILED, CaseOutcome, judge_case, record_of
from gaussian_enhancer.metrics.records import Record

Task = tuple[Case, Precision, str]


def matrix_records(
    cases: Sequence[Case], precisions: Sequence[Precision] = PRECISIONS, threads: int = 1
) -> Iterator[Record]:
    """Compute a record for each case, precision and pass.

    Args:
        cases: must be picklable, since another process computes them.
        precisions: columns of the matrix.
        threads: number of threads of the other process.
    """
    remaining: list[Task] = [(c, p, d) for c in cases for p in precisions for d in c.passes]
    while remaining:
        worker = _Worker(remaining, threads)
        try:
            while remaining:
                case, precision, direction = remaining[0]
                cell = worker.answer(case.seconds)
                remaining.pop(0)
                yield record_of(case, precision, direction, cell)
                if not worker.alive:  # a new process computes the rest
                    break
        finally:
            worker.end()


class _Worker:
    """A process that computes cells one after the other.

    It is spawned, not forked: compiled kernels that have already run do not work after a fork.
    """

    def __init__(self, tasks: Sequence[Task], threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.answers, worker_end = context.Pipe(duplex=False)
        self.process = context.Process(target=compute, args=(tuple(tasks), worker_end, threads), daemon=True)
        self.process.start()
        worker_end.close()
        self.alive = True
        self.answer(600.0)  # imports are slow on a busy machine

    def answer(self, seconds: float) -> CaseOutcome:
        """The outcome of the next cell; a failure if none arrives in time or the process dies."""
        if not self.answers.poll(seconds):
            self.alive = False
            return CaseOutcome(FAILED, f"has no result after {seconds:g} s", seconds=seconds)
        try:
            cell: CaseOutcome = self.answers.recv()
        except EOFError:
            self.process.join()
            self.alive = False
            return CaseOutcome(FAILED, f"exited with code {self.process.exitcode}")
        return cell

    def end(self) -> None:
        """Stop the process."""
        self.process.kill()
        self.process.join()
        self.answers.close()


def compute(tasks: Sequence[Task], answers: Connection, threads: int) -> None:
    """Main function of the worker process: sends an empty outcome when ready, then an outcome for each task."""
    torch.set_num_threads(threads)
    answers.send(CaseOutcome(""))
    for case, precision, direction in tasks:
        answers.send(judge_case(case, precision, direction))
