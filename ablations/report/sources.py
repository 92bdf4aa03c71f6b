"""Where the numbers of a page come from, as Markdown."""

from collections.abc import Sequence

from gaussian_enhancer.metrics.records import Record


def sources(records: Sequence[Record], source: str, counted: str = "", between: str = "; ") -> str:
    """Protocol, machine, commit, time and file of the records, a line each.

    Args:
        records: all that the page shows.
        source: their file, as the page links it.
        counted: what the records are, before their number.
        between: what stands between two protocols.
    """
    lines = [
        f"- protocol: {between.join(sorted({record.protocol for record in records} - {''}))}",
        f"- machine: {'; '.join(sorted({record.machine for record in records}))}",
        f"- commit: {', '.join(sorted({record.commit for record in records}))} (`+`: with changes of its own)",
        f"- measured: {min((r.time for r in records), default='')} to {max((r.time for r in records), default='')}",
        f"- {counted}{len(records)} records in [{source.rsplit('/', 1)[-1]}]({source})",
    ]
    return "\n".join(lines) + "\n"
