"""The page of a report: one file, with its pictures and its style inside."""

import base64
from functools import cache
from importlib import resources

import jinja2

from planeopt.report.content import Page

_FOLDER = "planeopt.report"


def to_html(page: Page) -> str:
    """Return the page as HTML that refers to nothing outside itself; names of files are escaped."""
    return _template().render(page=page, css=_text("page.css").strip())


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["base64"] = _base64
    return environment.from_string(_text("page.html.j2"))


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


def _text(name: str) -> str:
    return resources.files(_FOLDER).joinpath(name).read_text(encoding="utf-8")
