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
    head, defaults, body = _parts((conf / f"{job}.yaml").read_text(encoding="utf-8"))
    _, _, base = _parts((conf / "base.yaml").read_text(encoding="utf-8"))
    overrides = dict(word.split("=", 1) for word in words if "=" in word)
    groups = [(group, overrides.get(group, choice), comment) for group, choice, comment in _groups(defaults, conf)]
    body = body.split("\nhydra:")[0]
    parts = [USAGE.format(job=job), head, _section(f"options of {job}, with their defaults", body)]
    if groups:
        parts.append(_section("groups: GROUP=CHOICE selects a file of options", "\n".join(_choices(groups, conf))))
    for group, choice, _ in groups:
        file = conf / group / f"{choice}.yaml"
        if file.is_file():
            description, _, options = _parts(file.read_text(encoding="utf-8"))
            parts.append(_section(f"options of {group}={choice}", f"{description}\n{options}".strip()))
    job_options = {line.partition(":")[0] for line in body.splitlines()} - {"runtime"}
    shared_lines = [
        line for line in base.split("\nhydra:")[0].splitlines() if line.partition(":")[0] not in job_options
    ]
    parts.append(_section("options of every job", "\n".join(shared_lines)))
    return "\n".join(part for part in parts if part)


def _parts(text: str) -> tuple[str, str, str]:
    """Split a configuration file into its leading comments without ``#``, its defaults list, and the rest."""
    lines = text.splitlines()
    count = next((i for i, line in enumerate(lines) if not line.startswith("#")), len(lines))
    head = "".join(line.removeprefix("#").removeprefix(" ") + "\n" for line in lines[:count])
    rest, defaults = lines[count:], []
    if rest and rest[0].startswith("defaults:"):
        defaults.append(rest.pop(0))
        while rest and rest[0].startswith((" ", "-", "#")):
            defaults.append(rest.pop(0))
    body = "\n".join(line for line in rest if not line.lstrip().startswith(("_target_:", "this_run:")))
    return head, "\n".join(defaults), body.strip("\n")


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
