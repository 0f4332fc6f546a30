"""The words of every study as committed are those of its committed tables."""

import importlib
import re
from pathlib import Path
from typing import cast

import pytest
from matplotlib.figure import Figure

from studies.__main__ import INDEXES, RESULTS, STUDIES, main
from studies.study import HEADLINE, Number, Result, Study, read_rows, rounded


def of_tables(name: str, folder: Path) -> Result:
    return cast(Study, importlib.import_module(f"studies.{name}")).from_tables(folder)


@pytest.mark.parametrize("name", STUDIES)
def test_the_committed_words_are_made_from_the_committed_tables(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # What figures look like is not what is held here.
    monkeypatch.setattr(Figure, "draw_without_rendering", lambda *_: None)
    folder = RESULTS / name
    result = of_tables(name, folder)
    assert (folder / "finding.md").read_text(encoding="utf-8") == result.finding.rstrip() + "\n"
    shown = re.search(f"<!-- {name} -->\n(.*?)<!-- /{name} -->", INDEXES[0].read_text(encoding="utf-8"), re.DOTALL)
    assert shown is not None
    assert " ".join(shown[1].split()) == " ".join(result.headline.split())
    said = rounded(Number(key, float(value)) for key, value in result.numbers.items())
    assert read_rows(folder / f"{HEADLINE}.csv", Number) == said
    for table, rows in result.tables.items():
        before = read_rows(folder / f"{table}.csv", type(rows[0]))
        for row, old in zip(rounded(rows), before, strict=True):
            for column, value in vars(row).items():
                # What is made of other tables may differ by the rounding of their digits.
                close = pytest.approx(value, rel=1e-4, nan_ok=True) if isinstance(value, float) else value
                assert getattr(old, column) == close, (table, column)


def test_words_and_figures_are_made_anew(tmp_path: Path) -> None:
    name = "rig_checks"
    (tmp_path / name).mkdir()
    tables = {path.name: path.read_bytes() for path in (RESULTS / name).glob("*.csv") if path.stem != HEADLINE}
    for file, content in tables.items():
        (tmp_path / name / file).write_bytes(content)
    main([name, "--redraw", "-o", str(tmp_path)])
    assert {path.name for path in (tmp_path / name).iterdir()} == {path.name for path in (RESULTS / name).iterdir()}
    for file, content in tables.items():
        assert (tmp_path / name / file).read_bytes() == content
    assert (tmp_path / name / "finding.md").read_text(encoding="utf-8").rstrip() == of_tables(
        name, tmp_path / name
    ).finding.rstrip()
