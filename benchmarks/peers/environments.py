"""The environments of the peers: made when they are first needed, kept in `.venv-peers`."""

import subprocess
import sys
from functools import cache
from pathlib import Path

_HERE = Path(__file__).parent
_PLACE = _HERE.parents[1] / ".venv-peers"


@cache
def environment(name: str) -> Path | str:
    """Return the Python of an environment with the packages of `NAME.txt`, or why there is none."""
    folder = _PLACE / name
    python, ready = folder / "bin" / "python", folder / ".ready"
    wanted = (_HERE / f"{name}.txt").read_text(encoding="utf-8")
    if ready.exists() and ready.read_text(encoding="utf-8") == wanted:
        return python
    for command in (
        [sys.executable, "-m", "venv", "--clear", str(folder)],
        [str(python), "-m", "pip", "install", "--quiet", "--only-binary", ":all:", "-r", str(_HERE / f"{name}.txt")],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            said = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
            return f"cannot be installed here: {said[-1] if said else f'status {done.returncode}'}"
    ready.write_text(wanted, encoding="utf-8")
    return python
