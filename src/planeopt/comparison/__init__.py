"""Every formulation with every solver on the same problems, from the same start: what each finds and what it costs."""

from planeopt.comparison.compare import Comparison, compare
from planeopt.comparison.files import FileComparison, compare_file, compare_files
from planeopt.comparison.problem import Case, compare_problem
from planeopt.comparison.rows import InBound, Root, Row, nearest_root
from planeopt.comparison.summary import Pooled, Summary, summarise

__all__ = [
    "Case",
    "Comparison",
    "FileComparison",
    "InBound",
    "Pooled",
    "Root",
    "Row",
    "Summary",
    "compare",
    "compare_file",
    "compare_files",
    "compare_problem",
    "nearest_root",
    "summarise",
]
