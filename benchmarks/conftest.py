"""Collect what was timed and print it at the end as tables of ratios."""

from collections.abc import Iterator
from typing import Any

import pytest

ROWS = pytest.StashKey[list[tuple[str, str, float, dict[str, Any]]]]()
COUNTS = {
    "iterations": "iterations",
    "evaluations": "evaluations",
    "derivative_evaluations": "derivatives",
    "difference": "difference",
}
"""What a test leaves in ``benchmark.extra_info``, and its column's head. ``each``, without a column, is by how many
problems a time is divided."""

UNITS_OF_TIME = ("SciPy least_squares", "cv2.GaussianBlur")
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


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Print a Markdown table for each group: best and median time, ratio of the best ones, counts, agreement."""
    rows = config.stash.get(ROWS, [])
    for group in dict.fromkeys(group for _, group, _, _ in rows):
        members = [row for row in rows if row[1] == group]
        unit = next((best for what, _, best, _ in members if what in UNITS_OF_TIME), min(row[2] for row in members))
        terminalreporter.section(group)
        columns = [name for name in COUNTS if any(name in info for _, _, _, info in members)]
        heads = ["what", "best ms", "median ms", "relative", *(COUNTS[name] for name in columns)]
        terminalreporter.write_line(f"| {' | '.join(heads)} |")
        terminalreporter.write_line("|" + len(heads) * "---|")
        for what, _, best, info in sorted(members, key=lambda row: row[2]):
            times = [f"{1e3 * best:.2f}", f"{1e3 * info['median']:.2f}", f"{best / unit:.2f}"]
            cells = [what, *times, *(_cell(info.get(name)) for name in columns)]
            terminalreporter.write_line(f"| {' | '.join(cells)} |")


def _cell(value: float | None) -> str:
    if value is None:
        return ""
    return str(value) if isinstance(value, int) else f"{value:.0e}"
