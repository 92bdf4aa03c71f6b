"""Help text of a job: each option with its default and its comment, read from the configuration files."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import yaml

USAGE = """\
usage: gaussian-enhancer {job} [key=value ...] [--cfg job] [-m]

--cfg job prints the whole configuration as it would be used; -m sweeps over comma-separated values.
"""


def help_text(job: str, words: Sequence[str], conf: Path) -> str:
    """Help text of a job.

    Args:
        job: the job's name.
        words: the other command-line arguments; ``splat=2dgs`` among them shows the options of that choice.
        conf: the folder of configurations.
    """
    description, defaults, body = _split((conf / f"{job}.yaml").read_text(encoding="utf-8"))
    _, _, base_body = _split((conf / "base.yaml").read_text(encoding="utf-8"))
    overrides = dict(word.split("=", 1) for word in words if "=" in word)
    groups = [(group, overrides.get(group, choice), comment) for group, choice, comment in _groups(defaults, conf)]
    body = body.split("\nhydra:")[0]
    sections = [USAGE.format(job=job), description, _section(f"options of {job}, with their defaults", body)]
    if groups:
        sections.append(_section("groups: GROUP=CHOICE selects a file of options", "\n".join(_choices(groups, conf))))
    for group, choice, _ in groups:
        file = conf / group / f"{choice}.yaml"
        if file.is_file():
            choice_description, _, options = _split(file.read_text(encoding="utf-8"))
            sections.append(_section(f"options of {group}={choice}", f"{choice_description}\n{options}".strip()))
    job_options = {line.partition(":")[0] for line in body.splitlines()} - {"runtime"}
    shared_lines = [
        line for line in base_body.split("\nhydra:")[0].splitlines() if line.partition(":")[0] not in job_options
    ]
    sections.append(_section("options of every job", "\n".join(shared_lines)))
    return "\n".join(filter(None, sections))


def _split(text: str) -> tuple[str, str, str]:
    """Split a configuration file into its leading comments without ``#``, its defaults list, and the rest."""
    lines = text.splitlines()
    count = next((i for i, line in enumerate(lines) if not line.startswith("#")), len(lines))
    description = "".join(line.removeprefix("#").removeprefix(" ") + "\n" for line in lines[:count])
    body_lines, defaults = lines[count:], []
    if body_lines and body_lines[0].startswith("defaults:"):
        defaults.append(body_lines.pop(0))
        while body_lines and body_lines[0].startswith((" ", "-", "#")):
            defaults.append(body_lines.pop(0))
    body = "\n".join(line for line in body_lines if not line.lstrip().startswith(("_target_:", "this_run:")))
    return description, "\n".join(defaults), body.strip("\n")


def _groups(defaults: str, conf: Path) -> Iterator[tuple[str, str, str]]:
    """Name, choice and comment of every configuration group in a defaults list."""
    lines = defaults.splitlines()
    for entry in (yaml.safe_load(defaults) or {}).get("defaults", []):
        if not isinstance(entry, dict):
            continue
        ((name, choice),) = entry.items()
        group = str(name).removeprefix("optional ")
        if (conf / group.split("@")[0]).is_dir():
            line = next((line for line in lines if f"{name}:" in line and "#" in line), "")
            yield group, "null" if choice is None else str(choice), line.partition("# ")[2]


def _choices(groups: Sequence[tuple[str, str, str]], conf: Path) -> Iterator[str]:
    for group, choice, comment in groups:
        folder = conf / group.split("@")[0]
        names = sorted(file.relative_to(folder).with_suffix("").as_posix() for file in folder.rglob("*.yaml"))
        yield f"{group}={choice}" + (f"  # {comment}" if comment else "")
        yield f"    of {', '.join(names)}"


def _section(title: str, text: str) -> str:
    return f"{title}:\n" + "".join(f"  {line}".rstrip() + "\n" for line in text.splitlines()) if text else ""
