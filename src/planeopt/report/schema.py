"""The JSON schema of `poses.json`."""

from typing import Any

import msgspec

from planeopt.report.record import ReportFile


def report_schema() -> dict[str, Any]:
    """Return the JSON schema of `poses.json`, as it is shipped beside this module."""
    schema = msgspec.json.schema(ReportFile)
    for definition in schema["$defs"].values():
        definition["description"] = " ".join(definition["description"].split())
        # All keys are always there, whatever has a default in Python.
        definition["required"] = list(definition["properties"])
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "planeopt report", **schema}
