"""Rendering of pages with Jinja2. All values are escaped, and an undefined name is an error."""

import json
from functools import cache
from importlib.resources import files
from typing import Any

from markupsafe import Markup

from gaussian_enhancer.metrics.records import stringify_non_finite

PACKAGE = "gaussian_enhancer.report"


def render(template: str, values: dict[str, Any], package: str = PACKAGE) -> str:
    """Render a template of a package.

    Characters that are not allowed in HTML documents (control characters, lone surrogates of undecodable file names)
    are replaced by U+FFFD.

    Args:
        template: file name in the package's folder ``templates``.
        values: values by the names that the template uses.
        package: package of the template, which may include templates of `PACKAGE`.
    """
    return str(_environment(package).get_template(template).render(values)) + "\n"


@cache
def _environment(package: str) -> Any:
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    loader = ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((package, PACKAGE))])
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_replace_illegal_characters,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["resource"] = resource
    environment.filters["repr"] = repr
    environment.filters["json_block"] = json_block
    return environment


def resource(name: str, package: str = PACKAGE) -> Markup:
    """The text of a file in a package's folder ``templates``, not escaped."""
    return Markup(files(package).joinpath("templates", name).read_text(encoding="utf-8"))


def json_block(value: Any) -> Markup:
    """JSON for a script element: characters that could end it are escaped, and non-finite numbers become text."""
    text = json.dumps(stringify_non_finite(value), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def _replace_illegal_characters(value: Any) -> Any:
    if isinstance(value, Markup) or not isinstance(value, str):
        return value
    return "".join(c if c in "\t\n\r" or (ord(c) >= 32 and not 0xD800 <= ord(c) <= 0xDFFF) else "\ufffd" for c in value)
