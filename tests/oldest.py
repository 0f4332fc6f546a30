"""The oldest versions that pyproject.toml allows, as constraints for pip: `make test-oldest` installs these."""

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"
_FLOOR = re.compile(r"(?P<name>[A-Za-z0-9._-]+)(?:\[[^\]]*\])?>=(?P<floor>[0-9.]+),<[0-9.]+")


def constraints() -> list[str]:
    """Return `NAME==FLOOR.*` for each dependency of the package and of its tests; the newest patch of the oldest."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    found = []
    for requirement in (*project["dependencies"], *project["optional-dependencies"]["test"]):
        parts = _FLOOR.fullmatch(requirement)
        if parts is None:
            raise SystemExit(f"pyproject.toml: {requirement!r} has not the form NAME>=FLOOR,<CAP")
        found.append(f"{parts['name']}=={parts['floor']}.*")
    return found


if __name__ == "__main__":
    print("\n".join(constraints()))  # noqa: T201 - the output is what it is for
