"""The JSON schema of `scene.toml`, with the meaning of every key."""

import inspect
import re
from typing import Any

import msgspec

from planeopt.simulation import file
from planeopt.simulation.file import SceneFile

# In a NumPy docstring: "name : type" or "name, name : type", then indented lines.
_ENTRY = re.compile(r"^(\w+(?:, \w+)*)(?: : .*)?\n((?: {4}.*\n?)*)", re.MULTILINE)


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of `scene.toml`, as it is shipped beside this module."""
    schema = msgspec.json.schema(SceneFile)
    for name, definition in schema["$defs"].items():
        summary, meanings = _documented(getattr(file, name))
        definition["description"] = summary
        for key, meaning in meanings.items():
            # A reference cannot carry a description of its own; it has that of what it refers to.
            if "$ref" not in definition["properties"][key]:
                definition["properties"][key]["description"] = meaning
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "planeopt scene", **schema}


def _documented(table: type) -> tuple[str, dict[str, str]]:
    """Return what a table's docstring says of it and of each of its keys."""
    head, _, parameters = inspect.cleandoc(table.__doc__ or "").partition("Parameters\n----------\n")
    meanings = {
        name: " ".join(entry[2].split())
        for entry in _ENTRY.finditer(parameters)
        for name in entry[1].split(", ")
        if entry[2]
    }
    return " ".join(head.split()), meanings
