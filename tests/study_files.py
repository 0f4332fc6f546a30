"""What the tests of studies share: a quick form's files are those of the full form."""

from pathlib import Path

from studies.study import Result, write


def written(result: Result, folder: Path, committed: Path) -> Path:
    """Write a result and return its folder, where files are of the same names as those committed."""
    write(result, folder)
    assert {path.name for path in folder.iterdir()} == {path.name for path in committed.iterdir()}
    return folder
