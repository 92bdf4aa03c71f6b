"""Makes the page of the quality study as Markdown, from its records alone."""

from collections.abc import Sequence

from ablations.study import sections
from ablations.study.aims import Aims, methods_of_role
from ablations.study.markdown import markdown
from ablations.study.results import Results
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER


def quality_page(title: str, about: str, tables: Sequence[tuple[Results, Aims]], link: str) -> str:
    """The page as Markdown.

    Args:
        title: its heading.
        about: what was measured and by which command, Markdown.
        tables: study and records of each table, and the aims of the study's own methods.
        link: address of the records' file, relative to the page.
    """
    parts = [f"# {title}\n", f"{about.strip()}\n", *(part for table in tables for part in _parts(*table))]
    records = [record for results, _ in tables for record in results.records]
    measured_metrics = [name for name in sections.TITLES if any(name in record.metrics for record in records)]
    directions = ", ".join(f"{name} {'higher' if HIGHER_IS_BETTER[name] else 'lower'}" for name in measured_metrics)
    parts += ["## Where the numbers come from\n"]
    parts += [sections.source_list(records, link, "frames: ") + f"- better is {directions}\n"]
    return "\n".join(parts)


def _parts(results: Results, aims: Aims) -> list[str]:
    """A table's sections: methods, aims, scenes, frames made worse, scene-splat pairs, missing values."""
    study = results.study
    parts = [f"## {study.title}\n", f"{study.about.strip()}\n", sections.methods_list(results)]
    if methods_of_role(results, "ours"):
        parts += ["### Aims\n", markdown(sections.aims_table(results, aims))]
    parts += ["### By scene\n", READING, markdown(sections.scene_table(results))]
    if aims.allowed:
        parts += ["### Frames made worse\n", sections.harm_list(results, aims.allowed)]
    for metric in sections.metrics_of(results):
        parts += [f"### By scene and splat: {sections.TITLES[metric]}\n"]
        parts += [markdown(sections.pair_table(results, metric))]
    return [*parts, "### Missing\n", sections.missing_list(results)]


READING = (
    "Mean over scene-splat pairs (each scene, splatting method and density has the same weight), then the gain over "
    "the first method with its 95% interval: BCa bootstrap over the scene's views, none below 6 views. A method "
    "that lacks pairs is averaged over those that it has, and its gain is over the first method on the same pairs.\n"
)
