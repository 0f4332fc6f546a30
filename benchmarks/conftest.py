"""Collect what was timed and print it at the end as tables of ratios."""

import math
import os
import platform
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import pytest

README = Path(__file__).parent / "README.md"
LIBRARIES = ("numpy", "scipy", "casadi", "opencv-contrib-python-headless")
BEGIN, END = "<!-- tables -->\n", "<!-- /tables -->"
ROWS = pytest.StashKey[list[tuple[str, str, float, dict[str, Any]]]]()
COUNTS = {
    "iterations": ("iterations", "d"),
    "evaluations": ("evaluations", "d"),
    "derivative_evaluations": ("derivatives", "d"),
    "difference": ("difference", ".0e"),
    "over_bound": ("error over bound", ".2f"),
    "failures": ("failures", "d"),
    "reason": ("reason", ""),
}
"""What a test leaves in ``benchmark.extra_info``, its column's head and format. ``each``, without a column, is by how
many problems a time is divided."""

UNITS_OF_TIME = ("SciPy least_squares", "SciPy least_squares, maximum likelihood", "cv2.GaussianBlur")
"""The row that the others' times are divided by; the fastest where a group has no such row."""


@pytest.fixture(autouse=True)
def _collected(request: pytest.FixtureRequest) -> Iterator[None]:
    yield
    benchmark: Any = request.node.funcargs.get("benchmark")
    if benchmark is None or benchmark.stats is None or "what" not in benchmark.extra_info:
        return
    stats = benchmark.stats.stats
    each = benchmark.extra_info.get("each", 1)
    info = {**benchmark.extra_info, "median": stats.median / each}
    request.config.stash.setdefault(ROWS, []).append((info["what"], benchmark.group or "", stats.min / each, info))


class Report(Protocol):
    """Adds a row that was timed elsewhere; without a time where nothing could be timed."""

    def __call__(self, group: str, what: str, seconds: float | None, /, **info: float | int | str) -> None: ...


@pytest.fixture
def report(request: pytest.FixtureRequest) -> Report:
    def add(group: str, what: str, seconds: float | None, /, **info: float | int | str) -> None:
        time = math.nan if seconds is None else seconds
        request.config.stash.setdefault(ROWS, []).append((what, group, time, {**info, "median": math.nan}))

    return add


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let `make bench` write what it prints into the document that explains it."""
    parser.addoption("--write-tables", action="store_true", help="put the tables into benchmarks/README.md")


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Print a Markdown table for each group: best and median time, ratio of the best ones, counts, agreement."""
    rows = config.stash.get(ROWS, [])
    if not rows:
        return
    lines = [machine()]
    for group in dict.fromkeys(group for _, group, _, _ in rows):
        lines += ["", f"## {group}", "", *_table([row for row in rows if row[1] == group])]
    for line in lines:
        terminalreporter.write_line(line)
    if config.getoption("--write-tables"):
        text = README.read_text(encoding="utf-8")
        before, after = text[: text.index(BEGIN) + len(BEGIN)], text[text.index(END) :]
        README.write_text(before + "\n".join([*lines, ""]) + after, encoding="utf-8")


def machine() -> str:
    """Say on what it was timed."""
    processor = next((line.split(":")[1].strip() for line in _processor() if line.startswith("model name")), "")
    versions = ", ".join(
        f"{name} {version(name)}" for name in ("numpy", "scipy", "casadi", "opencv-contrib-python-headless")
    )
    cores = f"{os.cpu_count()} cores{f' ({processor})' if processor else ''}"
    return f"{platform.system()} on {platform.machine()}, {cores}; Python {platform.python_version()}, {versions}."


def _processor() -> list[str]:
    described = Path("/proc/cpuinfo")
    return described.read_text(encoding="utf-8").splitlines() if described.exists() else []


def _table(members: list[tuple[str, str, float, dict[str, Any]]]) -> list[str]:
    fastest = min((row[2] for row in members if not math.isnan(row[2])), default=math.nan)
    unit = next((best for what, _, best, _ in members if what in UNITS_OF_TIME), fastest)
    columns = [name for name in COUNTS if any(info.get(name, "") != "" for _, _, _, info in members)]
    heads = ["what", "best ms", "median ms", "relative", *(COUNTS[name][0] for name in columns)]
    lines = [f"| {' | '.join(heads)} |", "|" + len(heads) * "---|"]
    for what, _, best, info in sorted(members, key=lambda row: (math.isnan(row[2]), row[2])):
        times = [_time(1e3 * best), _time(1e3 * info["median"]), _time(best / unit)]
        cells = [what, *times, *(_cell(info.get(name), COUNTS[name][1]) for name in columns)]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _time(value: float) -> str:
    """Two digits at least: a thousandth of a millisecond counts where a spot takes no more."""
    if math.isnan(value):
        return ""
    return f"{value:.2f}" if value >= 1 else f"{value:.2g}"


def _cell(value: float | str | None, style: str) -> str:
    return "" if value is None else format(value, style)
