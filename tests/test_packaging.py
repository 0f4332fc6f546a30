"""What is shipped, what may import what, and what must not be in the repository."""

import ast
import importlib.metadata
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import planeopt

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "planeopt"

ROOMS = (
    "errors",
    "ranks",
    "look",
    "executors",
    "whole_files",
    "toml_files",
    "plane",
    "rig",
    "equations",
    "paper",
    "conic",
    "spot",
    "board",
    "uncertainty",
    "solution",
    "nlp",
    "closed_form",
    "formulations",
    "solvers",
    "estimation",
    "methods",
    "accuracy",
    "record",
    "batch",
    "check",
    "posterior",
    "comparison",
    "design",
    "simulation",
    "calibration",
    "formats",
    "reproduction",
    "report",
    "example",
    "cli",
)
"""A room imports only from rooms above it."""


def tracked() -> list[Path]:
    """Files that git knows, or would take up."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a checkout: no list of the repository's files")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [path for name in listed.split("\0") if name and (path := ROOT / name).is_file()]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[zipfile.ZipFile]:
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--disable-pip-version-check"]
    built = subprocess.run([*pip, "--wheel-dir", folder, ROOT], capture_output=True, text=True, check=False)
    unreachable = re.search(r"No matching distribution found for .*|No module named pip", built.stderr)
    if unreachable:
        pytest.skip(f"the wheel cannot be built here: {unreachable[0]}")
    assert built.returncode == 0, built.stderr
    with zipfile.ZipFile(next(folder.glob("planeopt-*.whl"))) as archive:
        yield archive


def test_wheel_holds_the_package_its_types_and_the_example(wheel: zipfile.ZipFile):
    modules = {f"planeopt/{file.relative_to(PACKAGE).as_posix()}" for file in PACKAGE.rglob("*.py")}
    folder = ROOT / "calibration" / "example"
    example = {f"planeopt/example/{f.relative_to(folder).as_posix()}" for f in folder.rglob("*") if f.is_file()}
    shipped = {name for name in wheel.namelist() if not name.split("/")[0].endswith(".dist-info")}
    assert any(name.endswith(".png") for name in example)
    schemas = {
        "planeopt/simulation/scene.schema.json",
        "planeopt/report/poses.schema.json",
        "planeopt/calibration/calibration.schema.json",
        "planeopt/comparison/comparison.schema.json",
    }
    page = {"planeopt/report/page.css", "planeopt/report/page.html.j2"}
    assert shipped == modules | example | schemas | page | {"planeopt/py.typed"}


def test_wheel_names_its_command_and_carries_its_licence(wheel: zipfile.ZipFile):
    info = f"planeopt-{planeopt.__version__}.dist-info"
    assert "planeopt = planeopt.cli:main" in wheel.read(f"{info}/entry_points.txt").decode()
    assert wheel.read(f"{info}/licenses/LICENSE") == (ROOT / "LICENSE").read_bytes()


def test_one_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    assert cited is not None
    assert planeopt.__version__ == project["version"] == importlib.metadata.version("planeopt") == cited[1]


def test_public_names_resolve():
    assert len(set(planeopt.__all__)) == len(planeopt.__all__)
    for name in planeopt.__all__:
        assert getattr(planeopt, name) is not None
        assert name in dir(planeopt)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = planeopt.no_such_name


def _imports(file: Path) -> Iterator[tuple[str, int]]:
    """Modules and names of this package that a file imports, at any depth of its code, with the line."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}, line {node.lineno}: a relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from ((name, node.lineno) for name in names if name.split(".")[0] == "planeopt")


def _room(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def test_every_room_has_its_place():
    rooms = {_room(file) for file in PACKAGE.rglob("*.py")} - {"__init__", "__main__"}
    assert rooms == set(ROOMS)


def test_a_room_imports_only_from_rooms_above_it():
    wrong = []
    for file in sorted(PACKAGE.rglob("*.py")):
        room = _room(file)
        if room in ("__init__", "__main__"):
            continue
        above = {*ROOMS[: ROOMS.index(room) + 1], "__version__"}
        for name, line in _imports(file):
            source = name.removeprefix("planeopt").split(".")[1:2]
            if not above.issuperset(source or ["the package itself"]):
                wrong.append(f"{file.relative_to(ROOT)}, line {line}: {room} imports {name}")
    assert not wrong


def test_no_file_holds_a_path_of_somebodys_machine():
    # At the root of a file system: not in a link, not below another folder.
    path = re.compile(rb"(?<![\w./~-])/(?:home|Users|root|work|tmp|var|private|mnt|opt)/\w")
    outside = re.compile(rb"\.\./shared")
    found = []
    for file in tracked():
        content = file.read_bytes()
        if b"\0" in content:
            continue
        allowed = file == ROOT / ".ci" / "run"
        for number, line in enumerate(content.splitlines(), start=1):
            if path.search(line) or (outside.search(line) and not allowed):
                found.append(f"{file.relative_to(ROOT)}, line {number}: {line.strip()[:80]!r}")
    assert not found
