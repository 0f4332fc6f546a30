"""The bar of a long run: what is done, how fast, and how long it will take; imports rich, so commands do it late."""

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text


class RateColumn(ProgressColumn):
    """How many inputs a second are done, over the last half minute."""

    def render(self, task: Task) -> Text:
        """Return the rate; nothing before it is known."""
        return Text("" if not task.speed else f"{task.speed:.3g}/s", style="progress.data.speed")


def bar(console: Console) -> Progress:
    """Return the bar: gone when it ends, and silent where the console is no terminal."""
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        RateColumn(),
        TimeRemainingColumn(),
    )
    # Standard output is the results': rich would send it through the console of standard error.
    return Progress(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False)
