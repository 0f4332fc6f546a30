"""Studies: questions about the measurement answered by numbers, each with its table, its figure and its finding.

`make studies` runs them all; `python -m studies NAME` one of them. README.md lists them with their findings.
"""
