"""Collects renders, enhanced images and records of a run, matched by name."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.scene.photos import list_images, read_photo

RAW, ENHANCED, COST = "raw", "enhanced", "cost"


def compared_views(
    renders: Path,
    enhanced: Path,
    photos: Path | None,
    records: Iterable[Record],
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[ComparedView, ...]:
    """The views of a report: each render with its enhanced image and the measured values of both.

    Files and records are matched by file name without extension.

    Args:
        renders: folder of the renders before enhancement.
        enhanced: folder of enhanced images.
        photos: folder of photos, which may also hold photos of other views; None if there are none.
        records: quality of the variants ``raw`` and ``enhanced``, and cost in milliseconds of ``enhanced``; records
            of other views and variants are ignored.
        background: colour under transparent images.

    Raises:
        InputError: a render has no enhanced image, or a variant of a view was measured twice.
    """
    enhanced_files = {path.stem: path for path in list_images(enhanced)}
    photo_files = {} if photos is None else {path.stem: path for path in list_images(photos)}
    records_by_key = _records_by_key(records)
    views = []
    for path in list_images(renders):
        if path.stem not in enhanced_files:
            raise InputError(enhanced, f"has no enhanced image of {path.name}", "enhance the renders again")
        raw_record, enhanced_record, cost_record = (
            records_by_key.get((path.stem, variant)) for variant in (RAW, ENHANCED, COST)
        )
        photo_file = photo_files.get(path.stem)
        views.append(
            ComparedView(
                name=path.name,
                read_raw=partial(read_photo, path, background),
                read_enhanced=partial(read_photo, enhanced_files[path.stem], background),
                read_photo=None if photo_file is None else partial(read_photo, photo_file, background),
                metrics_raw=_known_values(raw_record),
                metrics_enhanced=_known_values(enhanced_record),
                milliseconds=_known_values(cost_record).get("milliseconds"),
                reasons={
                    **(raw_record.reasons if raw_record else {}),
                    **(enhanced_record.reasons if enhanced_record else {}),
                },
            )
        )
    return tuple(views)


def provenance_of(records: Sequence[Record], further_entries: Mapping[str, str]) -> dict[str, str]:
    """Provenance of a page's numbers: the distinct values that the records state.

    Args:
        records: the records that the page shows.
        further_entries: further entries, such as configuration and weights.
    """
    values_by_label = {
        "Scene": [record.scene for record in records],
        "Splat": [record.splat for record in records],
        "Commit": [record.commit for record in records],
        "Machine": [record.machine for record in records],
        "Protocol": [record.protocol for record in records],
    }
    entries = {label: ", ".join(dict.fromkeys(filter(None, values))) for label, values in values_by_label.items()}
    times = sorted(record.time for record in records)
    if times:
        entries["Measured"] = times[0] if times[0] == times[-1] else f"{times[0]} to {times[-1]}"
    return {label: value for label, value in {**entries, **further_entries}.items() if value}


def _records_by_key(records: Iterable[Record]) -> dict[tuple[str, str], Record]:
    """Records by view (without extension) and by variant, or ``cost`` for the cost of the variant ``enhanced``."""
    records_by_key: dict[tuple[str, str], Record] = {}
    for record in records:
        if not record.view or (record.kind == COST and record.variant != ENHANCED):
            continue
        key = (Path(record.view).stem, record.variant if record.kind == "quality" else record.kind)
        if key in records_by_key:
            received = f"was measured twice as {record.variant!r}"
            raise InputError(f"view {record.view}", received, "report one run at a time")
        records_by_key[key] = record
    return records_by_key


def _known_values(record: Record | None) -> dict[str, float]:
    return {} if record is None else {key: value for key, value in record.metrics.items() if value is not None}
