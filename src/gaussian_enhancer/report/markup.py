"""HTML by construction: whatever is not `Markup` is text, and text is escaped."""

import html
import json
import math
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from string import Template
from typing import Any

PACKAGE = "gaussian_enhancer.report"


class Markup(str):
    """A string that is HTML already."""

    __slots__ = ()


def escaped(value: str) -> Markup:
    """Text made safe for element content and for quoted attributes; markup stays as it is.

    Characters that no HTML document may hold (control characters, lone surrogates of undecodable file names)
    become U+FFFD.
    """
    if isinstance(value, Markup):
        return value
    legal = (c if c in "\t\n\r" or (ord(c) >= 32 and not 0xD800 <= ord(c) <= 0xDFFF) else "\ufffd" for c in value)
    return Markup(html.escape("".join(legal), quote=True))


def tag(name: str, *children: str, **attributes: str | float | bool | None) -> Markup:
    """An element with its children.

    Args:
        name: the element's name.
        *children: text (escaped) or markup (kept).
        **attributes: ``data_view`` becomes ``data-view``, ``class_`` becomes ``class``; True stands for an
            attribute without a value, None and False leave it out.
    """
    opening = name
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        opening += f" {key.rstrip('_').replace('_', '-')}"
        if value is not True:
            opening += f'="{escaped(str(value))}"'
    if name in ("img", "input", "meta", "link"):
        return Markup(f"<{opening}>")
    return Markup(f"<{opening}>{joined(*children)}</{name}>")


def joined(*parts: str) -> Markup:
    """Text and markup one after the other."""
    return Markup("".join(escaped(part) for part in parts))


def fill(template: str, values: Mapping[str, str], package: str = PACKAGE) -> Markup:
    """A template of a package with its ``$names`` replaced; text among the values is escaped.

    Args:
        template: file name in the package's folder ``templates``.
        values: exactly the names that the template asks for.
        package: whose template it is.
    """
    return Markup(
        Template(resource(template, package)).substitute({key: escaped(value) for key, value in values.items()})
    )


def head(title: str, style: str, policy: str) -> Markup:
    """A page up to the end of its head.

    Args:
        title: the page's title.
        style: its CSS.
        policy: directives of its content security policy for what it shows and runs; all else is forbidden.
    """
    values = {"title": title, "style": Markup(style), "policy": Markup(policy)}
    return Markup(fill("head.html", values).rstrip("\n"))


def json_block(value: Any) -> Markup:
    """JSON for a script element: no character that could end it; numbers that are not finite as words."""
    text = json.dumps(_finite(value), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


@cache
def resource(name: str, package: str = PACKAGE) -> str:
    """The text of a file in a package's folder ``templates``."""
    return files(package).joinpath("templates", name).read_text(encoding="utf-8")
