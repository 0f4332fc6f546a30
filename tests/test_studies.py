"""What holds of every study: its question, its committed results, and an index whose every number can be looked up."""

import csv
import importlib
import math
import re
from collections.abc import Iterator
from decimal import ROUND_HALF_DOWN, ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal
from pathlib import Path

import pytest

from studies.__main__ import INDEXES, RESULTS, STUDIES, main

INDEX = INDEXES[0].read_text(encoding="utf-8")
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")


def block(name: str) -> str:
    """The headline of a study as the index has it."""
    found = re.search(f"<!-- {name} -->\n(.*?)<!-- /{name} -->", INDEX, re.DOTALL)
    assert found is not None, f"studies/README.md has no block for {name}"
    return found[1]


def numbers_in(text: str) -> Iterator[str]:
    """The numbers of a text as they are written, without what belongs to names such as (29) or k1."""
    for found in _NUMBER.finditer(re.sub(r"\(\d+\)(?:-\(\d+\))?", "", text)):
        yield found[0].replace(",", "")


def rounds_to(value: str, shown: str) -> bool:
    """Whether a number shown is the rounding of a value, halves either way: the table itself is rounded."""
    place = Decimal(shown).as_tuple().exponent
    assert isinstance(place, int)
    ways = (ROUND_HALF_DOWN, ROUND_HALF_EVEN, ROUND_HALF_UP)
    return any(abs(Decimal(value)).quantize(Decimal((0, (1,), place)), way) == abs(Decimal(shown)) for way in ways)


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.parametrize("name", STUDIES)
class TestStudy:
    def test_begins_with_its_question(self, name: str) -> None:
        text = importlib.import_module(f"studies.{name}").__doc__
        assert text is not None
        question = " ".join(text.split("\n\n")[0].split())
        assert question.endswith("?")
        assert question in " ".join(INDEX.split()), "the index asks another question"

    def test_every_number_of_the_index_is_in_the_table_beside_it(self, name: str) -> None:
        values = {row["name"]: row["value"] for row in table(RESULTS / name / "headline.csv")}
        for shown in numbers_in(block(name)):
            assert any(rounds_to(value, shown) for value in values.values()), f"{shown} is not in headline.csv"

    def test_every_number_of_the_table_is_used(self, name: str) -> None:
        shown = list(numbers_in(block(name)))
        for row in table(RESULTS / name / "headline.csv"):
            assert any(rounds_to(row["value"], number) for number in shown), f"{row['name']} is said nowhere"

    def test_results_are_there_and_shown(self, name: str) -> None:
        files = {path.name for path in (RESULTS / name).iterdir()}
        assert {"finding.md", "headline.csv"} < files
        figures = {file for file in files if file.endswith(".png")}
        assert figures
        shown = set(re.findall(rf"\(results/{name}/([\w.]+)\)", INDEX))
        assert shown == files, f"not in the index, or not there: {shown ^ files}"


def test_the_front_page_says_what_the_index_says() -> None:
    front = INDEXES[1].read_text(encoding="utf-8")
    shown = re.findall(r"<!-- (\w+) -->\n(.*?)<!-- /\1 -->", front, re.DOTALL)
    assert {name for name, _ in shown} == {"calibration", "coverage", "basins"}
    for name, text in shown:
        assert text == block(name)


CHANCE = {"iterations", "evaluations", "derivative_evaluations", "right_over_allowed"}
"""Columns of the paper's study that other processors' rounding may change."""


def test_the_committed_results_are_those_of_the_command(tmp_path: Path) -> None:
    """One study is run as `make studies` runs it; other processors round otherwise, in the last of a table's digits.

    Where a search ends that is started far off hangs on such rounding: its tables are not compared.
    """
    main(["paper", "-o", str(tmp_path)])
    for old in sorted((RESULTS / "paper").glob("*.csv")):
        if old.stem in ("searches", "repeats", "headline"):
            continue
        rows, before = table(tmp_path / "paper" / old.name), table(old)
        for row, then in zip(rows, before, strict=True):
            assert row.keys() == then.keys()
            for column in row.keys() - CHANCE:
                assert same(row[column], then[column]), (old.name, column, row, then)


def same(value: str, then: str) -> bool:
    """Whether two cells are equal, as numbers to four digits, or both at the level of rounding."""
    try:
        return math.isclose(float(value), float(then), rel_tol=1e-4, abs_tol=1e-9)
    except ValueError:
        return value == then


def test_every_folder_of_results_is_a_study() -> None:
    assert {path.name for path in RESULTS.iterdir() if path.is_dir()} == set(STUDIES)


def test_the_index_claims_nothing_outside_its_blocks() -> None:
    text = re.sub(r"<!-- (\w+) -->\n.*?<!-- /\1 -->", "", INDEX, flags=re.DOTALL)
    questions = [importlib.import_module(f"studies.{name}").__doc__ or "" for name in STUDIES]
    for question in questions:
        text = " ".join(text.split()).replace(" ".join(question.split("\n\n")[0].split()), "")
    text = re.sub(r"\([^)]*\)|`[^`]*`", "", text)
    assert not list(numbers_in(text)), list(numbers_in(text))
