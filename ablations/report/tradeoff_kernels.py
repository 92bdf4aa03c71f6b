"""Makes the part on kernels of the page of error over run time: error against float64 over time."""

import math
from collections.abc import Iterator, Sequence

from ablations.study.markdown import frame, markdown
from ablations.study.plots import Mark, Panel, work_precision
from ablations.study.sections import missing_section
from gaussian_enhancer.metrics.records import MISSING, Record

ABOUT = """Each kernel in every dtype and implementation against the same in float64. Relative error is the root mean
square of the difference over that of the result. A mark is left out where its error is 0 or not finite; the table has
it. Inputs are small: times compare ways, they are not those of a whole image. The latent sampler is held against 512
steps; its error at 256 steps in float64 says how far these are from the end.
"""


def kernel_parts(records: Sequence[Record]) -> Iterator[tuple[str, str, str]]:
    """Yield parts of the page: text, name of a diagram, and the diagram; both are empty for a part without diagram.

    Args:
        records: of the kind numerics.
    """
    yield ABOUT, "", ""
    measured = [record for record in records if record.kind != MISSING]
    cases = dict.fromkeys(record.scene for record in measured)
    panels = [_panel(case, [record for record in measured if record.scene == case]) for case in cases]
    yield _table(measured), "numerics", work_precision("Error of kernels against float64", panels, 3)
    yield missing_section((f"{r.scene}, `{r.variant}`", r.reasons["row"]) for r in records if r.kind == MISSING), "", ""


def _panel(case: str, records: Sequence[Record]) -> Panel:
    curves: dict[str, list[Mark]] = {}
    for record in records:
        curve, _, setting = record.variant.partition("/")
        metrics = {name: value or 0.0 for name, value in record.metrics.items()}
        spread = metrics["lower_quartile"], metrics["upper_quartile"]
        mark = Mark(setting, metrics["milliseconds"], metrics["relative_error"], *spread)
        curves.setdefault(curve, []).append(mark)
    return Panel(case, "time, ms", "relative error", curves)


def _table(records: Sequence[Record]) -> str:
    rows = []
    for record in records:
        relative, largest = (record.metrics[name] or 0.0 for name in ("relative_error", "largest_error"))
        times = (record.metrics[name] or 0.0 for name in ("milliseconds", "lower_quartile", "upper_quartile"))
        median, low, high = times
        errors = [f"{value:.1e}" if math.isfinite(value) else "not finite" for value in (relative, largest)]
        rows.append((record.scene, record.variant, *errors, f"{median:.2f}", f"{low:.2f} to {high:.2f}"))
    return markdown(frame(("kernel", "way", "relative error", "largest error", "ms", "quartiles"), rows))
