"""Texts in YAML, JSON or XML as nested tables whose leaves are still text.

Leaves stay text because what a number, a truth value or a text is depends on the version of YAML: `1e-05`, `010` and
`no` all have two readings. Each format's own reader knows which it expects.

OpenCV's own reader is not used: on files that are damaged it can end the whole process (4.10 and 5.0 alike).
"""

import re
from typing import Any
from xml.etree import ElementTree

import yaml

from planeopt.errors import InputError

Document = dict[str, Any]
"""Keys to texts, lists or further tables."""

_ROOT, _NAMELESS = "opencv_storage", "_"
_ESCAPED_APOSTROPHE = re.compile(r"(?<!\\)((?:\\\\)*)\\'")
# OpenCV's JSON may have comments, each to the end of its line; within a text there is a quotation mark still to come.
_JSON_COMMENT = re.compile(r"(?<!\S)//[^\"\n]*$", re.MULTILINE)
_DIRECTIVE = re.compile(r"\A\ufeff?%YAML[^\n]*")


class _Loader(yaml.BaseLoader):
    """PyYAML's plainest loader: every scalar a text, every tag passed over; but a key that stands twice is refused."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            if key is not None and key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} stands there twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


def parse_yaml(text: str, source: str) -> Document:
    r"""Return the tables of a YAML or JSON text; OpenCV's dialects of both included.

    The header `%YAML:1.0`, which no version of YAML has, and the escape `\'`, which neither YAML nor JSON has, are
    OpenCV's. Its tags (`!!opencv-matrix`) are passed over.

    Raises
    ------
    InputError
        If the text is neither, or no table; names the line.
    """
    body = _ESCAPED_APOSTROPHE.sub(r"\1'", _DIRECTIVE.sub("", text))
    if body.lstrip().startswith("{"):
        # JSON may be indented with tabs, YAML may not.
        body = _JSON_COMMENT.sub("", body.replace("\t", " "))
    try:
        document = yaml.load(body, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f", line {error.problem_mark.line + 1}"
        raise InputError(f"{source}{line}: not valid YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InputError(f"{source}: not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(document, dict):
        raise InputError(f"{source}: holds no keys at all, so it is not a camera's file")
    return document


def parse_xml(text: str, source: str) -> Document:
    """Return the tables of an XML text as OpenCV's FileStorage writes it.

    Raises
    ------
    InputError
        If the text is not XML, or not of that kind; names the line.
    """
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(
            f"{source}, line {error.position[0]}: not valid XML: {str(error).partition(':')[0]}"
        ) from error
    except ValueError as error:
        raise InputError(f"{source}: not valid XML: {error}") from error
    if root.tag != _ROOT:
        raise InputError(f"{source}: OpenCV's XML begins with <{_ROOT}>, not <{root.tag}>")
    tables = _table(root, source)
    if not isinstance(tables, dict):
        raise InputError(f"{source}: holds no keys at all, so it is not a camera's file")
    return tables


def _table(parent: ElementTree.Element, source: str) -> Any:
    """Return the children by their names; where OpenCV gives them none, they are a list."""
    names = [child.tag for child in parent]
    content = [_table(child, source) if len(child) else (child.text or "").strip().strip('"') for child in parent]
    if all(name == _NAMELESS for name in names) and names:
        return content
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{source}: the key {twice!r} stands there twice")
    return dict(zip(names, content, strict=True))
