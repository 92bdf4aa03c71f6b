"""Records of rows that could not be measured, with their reasons."""

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import MISSING, Record


def missing_record(
    variant: str,
    reason: str,
    *,
    run: str = "",
    scene: str = "",
    splat: str = "",
    view: str = "",
    seed: int | None = None,
    sources: dict[str, str] | None = None,
) -> Record:
    """Make the record for a row that could not be measured.

    Args:
        variant: the method.
        reason: why the row could not be measured.
        run: see `Record`.
        scene: see `Record`.
        splat: see `Record`.
        view: see `Record`.
        seed: see `Record`.
        sources: the runs that the result would have come from.
    """
    return Record(MISSING, run, scene, splat, view, variant, {}, {"row": reason}, seed=seed, sources=sources or {})


def reason_of(error: BaseException) -> str:
    """Format an error as the reason that a record gives for a missing result.

    An `InputError` is given by its message, any other error by its type and message.

    Args:
        error: the error that prevented the result.
    """
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
