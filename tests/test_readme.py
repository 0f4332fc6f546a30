"""The documents: their commands and examples are run, their numbers are the ones printed, their lists are complete."""

import contextlib
import io
import math
import os
import re
import subprocess
import sys
import tomllib
from enum import Enum
from pathlib import Path

import msgspec
import pytest

import planeopt as po
from planeopt.cli import build_app
from planeopt.example import example_folder
from planeopt.methods import FORMULATIONS, METHODS, SOLVERS
from planeopt.record import PoseRecord
from planeopt.rig import PARAMETERS, rig_from_dict
from planeopt.solution import Flag, Status
from planeopt.spot import NoSpotReason, SpotFlag

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
FILES = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_TOKEN = re.compile(r"\.\.\.|[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?|[^\W\d]\w*|[^\s─]")
_NUMBER = re.compile(r"[-+]?\d+(?:\.(\d+))?(?:e([-+]?\d+))?")


def blocks(document: str) -> list[tuple[str, str]]:
    """Language and text of each fenced block, in order."""
    return [(match[1], match[2]) for match in _BLOCK.finditer(document)]


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in an empty folder where the example lies as in a checkout."""
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "example").symlink_to(example_folder(), target_is_directory=True)
    monkeypatch.chdir(tmp_path)


def same(shown: str, printed: str) -> bool:
    """Whether a token is what was printed; numbers within the rounding of the one that is shown.

    A document may round, and another machine's last digits may differ: half a unit for the one and one for the other.
    """
    number = _NUMBER.fullmatch(shown)
    if number is None or not _NUMBER.fullmatch(printed):
        return shown == printed
    unit = 10.0 ** (int(number[2] or 0) - len(number[1] or ""))
    whole = number[1] is None and number[2] is None
    return shown == printed if whole else math.isclose(float(shown), float(printed), rel_tol=0, abs_tol=1.5 * unit)


def missing_piece(shown: str, printed: str) -> str | None:
    """What a document shows and the output does not hold, in order; `...` stands for anything, white space for none."""
    pieces, output = [[]], _TOKEN.findall(printed)
    for token in _TOKEN.findall(shown):
        if token == "...":
            pieces.append([])
        else:
            pieces[-1].append(token)
    begin = 0
    for i, piece in enumerate(pieces):
        end = len(output) - len(piece)
        # The first piece begins the output, the last one ends it, unless the document says `...` there.
        places = range(begin, end + 1) if i else range(min(1, end + 1))
        if i == len(pieces) - 1 and piece:
            places = [at for at in places if at == end]
        at = next((at for at in places if all(map(same, piece, output[at : at + len(piece)]))), None)
        if at is None:
            return " ".join(piece)
        begin = at + len(piece)
    return None


def test_numbers_are_compared_as_they_are_shown():
    assert missing_piece("z = 1.23 mm", "z  =  1.2349\nmm") is None
    assert missing_piece("z = 1.23 mm", "z = 1.25 mm") == "z = 1.23 mm"
    assert missing_piece("a ... d 4", "a b c d 4") is None
    assert missing_piece("a ... d 4", "a b c d 5") == "d 4"
    assert missing_piece("a ...", "b a") == "a"
    assert missing_piece("... a", "a b") == "a"
    assert missing_piece("a", "a b") == "a"
    assert missing_piece("a b", "a") == "a b"
    assert missing_piece("1.5e-03 ...", "1.6e-03") is None
    assert missing_piece("1.5e-03 ...", "1.8e-03") == "1.5e-03"


@pytest.mark.usefixtures("checkout")
def test_python_examples_run_and_print_what_is_shown():
    names, printed, shown = {}, "", 0
    for language, text in blocks(README):
        if language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as output:
                exec(compile(text, "README.md", "exec"), names)
            printed = output.getvalue()
        elif language == "text":
            assert missing_piece(text, printed) is None, printed
            shown += 1
    assert shown == 2
    assert f"{Flag.WEAK.name.lower()}: {Flag.WEAK.value}" in printed


CONSOLES = [text for language, text in blocks(README) if language == "console"]


@pytest.mark.usefixtures("checkout")
@pytest.mark.parametrize("console", CONSOLES, ids=lambda text: " ".join(text.split()[1:4]))
def test_commands_run_and_print_what_is_shown(console: str):
    prompt, shown = console.split("\n", 1)
    assert prompt.startswith("$ planeopt ")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    ended = subprocess.run(
        ["sh", "-c", prompt.removeprefix("$ ")],
        env=os.environ | {"PATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout
    assert missing_piece(shown, ended.stdout) is None, ended.stdout


def test_every_command_is_named_and_no_other():
    commands = {name for name in build_app() if not name.startswith("-")}
    table = set(re.findall(r"^\| `planeopt (\w+)", README, re.MULTILINE))
    assert table == commands
    assert set(re.findall(r"(?:`|\$ )planeopt ([a-z]\w*)", README)) <= commands


def test_every_target_of_make_is_there():
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(re.findall(r"(?:`|^    )make (\w+)", README, re.MULTILINE)) <= targets


def test_formulations_and_solvers_are_all_in_the_table_with_the_solvers_that_suit_them():
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in README.splitlines() if line[:3] == "| `"]
    listed = {row[0].strip("`"): set(re.findall(r"`(\w+(?:\(\w+\))?)`", row[2])) for row in rows if len(row) == 4}
    suits = {name: {m.solver.name for m in METHODS if m.formulation.name == name and m.solver} for name in FORMULATIONS}
    assert listed == suits
    assert set.union(*listed.values()) == set(SOLVERS)


@pytest.mark.parametrize("document", ["README.md", "CHANGELOG.md", "docs/files.md"])
def test_links_lead_somewhere(document: str):
    text = (ROOT / document).read_text(encoding="utf-8")
    targets = [target for target in re.findall(r"\]\(([^)]+)\)", text) if not target.startswith("https://")]
    missing = [target for target in targets if not (ROOT / document).parent.joinpath(target).exists()]
    assert not missing


@pytest.mark.parametrize("document", [README, FILES], ids=["README.md", "files.md"])
def test_rig_files_that_are_shown_are_accepted(document: str):
    texts = [text for language, text in blocks(document) if language == "toml" and "[camera]" in text]
    assert texts
    for text in texts:
        rig = rig_from_dict(tomllib.loads(text), "the document")
        assert rig.require_beam().radius == 6.0
        assert (rig.covariance is not None) == ("[covariance]" in text)


def test_the_rig_in_the_readme_is_the_examples():
    text = next(text for language, text in blocks(README) if language == "toml" and "[camera]" in text)
    assert rig_from_dict(tomllib.loads(text), "README") == po.load_rig(example_folder() / "truth_rig.toml")


def test_the_boundary_points_that_are_shown_are_accepted(tmp_path: Path):
    text = next(text for language, text in blocks(FILES) if language == "csv" and text.startswith("x_px"))
    (tmp_path / "points.csv").write_text(text, encoding="utf-8")
    rig = po.load_rig(example_folder() / "truth_rig.toml")
    solution = po.solve(po.read_points(tmp_path / "points.csv"), rig)
    # Five rounded points of target05: the plane is near the truth, 214.16 mm at 50 deg, well within its five sigmas.
    assert solution.pose is not None
    assert solution.sigma is not None
    assert abs(solution.pose.z_L - 214.1625) < 5 * solution.sigma.z_L


def names_in_table(heading: str) -> dict[str, str]:
    """First and last column of the table under a heading of `docs/files.md`."""
    section = re.split(r"^#+ ", FILES.split(f" {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:3] == "| `"]
    return {row[0].strip("`"): row[-1] for row in rows}


@pytest.mark.parametrize(
    ("heading", "meanings"),
    [
        ("How a solve ends", Status),
        ("Flags of a solution", Flag),
        ("Flags of a spot", SpotFlag),
        ("Why there is no spot", NoSpotReason),
    ],
)
def test_statuses_and_flags_are_all_listed_with_their_sentences(heading: str, meanings: type[Enum]):
    assert names_in_table(heading) == {meaning.name.lower(): meaning.value for meaning in meanings}


def test_records_of_statuses_are_as_listed():
    for status in Status:
        assert f"| `{status.name.lower()}` | `{status.record}` |" in FILES


def test_keys_of_the_record_are_all_listed():
    section = FILES.split("## The pose record\n", 1)[1].split("### ", 1)[0]
    first_cells = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    listed = [key for cell in first_cells for key in re.findall(r"`(\w+)`", cell)]
    assert listed == [field.name for field in msgspec.structs.fields(PoseRecord)]


def test_parameters_of_the_covariance_are_all_listed():
    section = FILES.split("The parameters that a covariance can speak of", 1)[1].split("The\nmatrix", 1)[0]
    assert set(re.findall(r"`(\w+)`", section)) == set(PARAMETERS)
