"""From what lies on disk to what a report compares: renders, enhanced images and records, matched by name."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.measure.records import Record
from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.scene.photos import decode, list_images
from gaussian_enhancer.scene.rendered import RenderedView

RAW, ENHANCED = "raw", "enhanced"


def compared_views(
    targets: Sequence[RenderedView], enhanced: Path, records: Iterable[Record]
) -> tuple[ComparedView, ...]:
    """The views of a report: every target with its enhanced image and the numbers that were measured on both.

    Args:
        targets: the renders as they came, with their photos where they are known.
        enhanced: folder of enhanced images, named as the renders (any image ending).
        records: quality of the variants ``raw`` and ``enhanced``, and cost in milliseconds of ``enhanced``; records
            of other views and variants are not used.

    Raises:
        InputError: a target has no enhanced image, or a variant of a view was measured twice.
    """
    files = {path.stem: path for path in list_images(enhanced)}
    by_view = _by_view(records)
    views = []
    for target in targets:
        stem = Path(target.name).stem
        if stem not in files:
            raise InputError(enhanced, f"has no enhanced image of {target.name}", "enhance the run again")
        if target.read is None:
            raise InputError(f"view {target.name}", "has no render", "name a run with renders")
        raw, after = by_view.get((target.name, RAW)), by_view.get((target.name, ENHANCED))
        cost = by_view.get((target.name, "cost"))
        views.append(
            ComparedView(
                name=target.name,
                read_raw=target.read,
                read_enhanced=partial(decode, files[stem]),
                read_photo=target.read_photo,
                metrics_raw=_known(raw),
                metrics_enhanced=_known(after),
                milliseconds=_known(cost).get("milliseconds"),
                reasons={**(raw.reasons if raw else {}), **(after.reasons if after else {})},
            )
        )
    return tuple(views)


def provenance_of(records: Sequence[Record], others: Mapping[str, str]) -> dict[str, str]:
    """What a page says of where its numbers come from: what the records state, each value once, then the rest.

    Args:
        records: the records that the page shows.
        others: further lines: configuration, weights.
    """
    lines = {
        "Scene": [record.scene for record in records],
        "Splat": [record.splat for record in records],
        "Commit": [record.commit for record in records],
        "Machine": [record.machine for record in records],
        "Protocol": [record.protocol for record in records],
    }
    stated = {label: ", ".join(dict.fromkeys(filter(None, values))) for label, values in lines.items()}
    times = sorted(record.time for record in records)
    if times:
        stated["Measured"] = times[0] if times[0] == times[-1] else f"{times[0]} to {times[-1]}"
    return {label: value for label, value in {**stated, **others}.items() if value}


def _by_view(records: Iterable[Record]) -> dict[tuple[str, str], Record]:
    found: dict[tuple[str, str], Record] = {}
    for record in records:
        if record.kind == "cost" and record.variant != ENHANCED:
            continue
        key = (record.view, record.variant if record.kind == "quality" else record.kind)
        if key in found:
            received = f"was measured twice as {record.variant!r}"
            raise InputError(f"view {record.view}", received, "report one run at a time")
        found[key] = record
    return found


def _known(record: Record | None) -> dict[str, float]:
    return {} if record is None else {key: value for key, value in record.metrics.items() if value is not None}
