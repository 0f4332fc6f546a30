"""From inputs to a report: its numbers, its page, its files."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from planeopt import __version__
from planeopt.batch import StrPath
from planeopt.errors import InputError
from planeopt.estimation.sequence import Positions
from planeopt.report.batch_section import batch_section
from planeopt.report.content import Page, Section
from planeopt.report.examine import Examined, Options, examine_many
from planeopt.report.html import to_html
from planeopt.report.pdf import to_pdf
from planeopt.report.record import Provenance, ReportFile, Settings
from planeopt.report.sections import anchor_of, assumptions, image_section
from planeopt.report.summary import summarise
from planeopt.rig import Rig
from planeopt.whole_files import write_text, write_whole

JSON, HTML, PDF = FILES = "poses.json", "report.html", "report.pdf"


@dataclass(frozen=True, eq=False)
class Report:
    """A report, ready to be written.

    Attributes
    ----------
    file : ReportFile
        What `poses.json` holds.
    page : Page
        What HTML and PDF show.
    """

    file: ReportFile
    page: Page

    @property
    def html(self) -> str:
        """The page, in one file that needs no other."""
        return to_html(self.page)

    @property
    def pdf(self) -> bytes:
        """The same on paper."""
        return to_pdf(self.page, self.file.provenance.time)

    def write(self, folder: Path) -> None:
        """Write `poses.json`, `report.html` and `report.pdf` into a folder that is there, each whole or not at all.

        Raises
        ------
        InputError
            If a file cannot be written.
        """
        write_text(folder / JSON, self.file.to_json())
        write_text(folder / HTML, self.html)
        write_whole(folder / PDF, lambda path: path.write_bytes(self.pdf))


def build(
    paths: Sequence[StrPath],
    rig: Rig,
    provenance: Provenance,
    options: Options | None = None,
    *,
    combined: bool = False,
    positions: Positions | None = None,
    executor: Executor | None = None,
) -> Report:
    """Measure inputs and report on them.

    Parameters
    ----------
    paths : sequence of path-like
        Images, or `.csv` files of boundary points. What is wrong with one of them is in its own section.
    rig : Rig
        With a beam.
    provenance : Provenance
        Where the report comes from: what it says of time, command and versions.
    options : Options, optional
    combined : bool
        All show one plane: combine them.
    positions : Positions, optional
        They are a sequence, one position for each input.
    executor : Executor, optional
        Where the inputs are examined; in this process unless given.

    Returns
    -------
    Report

    Raises
    ------
    InputError
        If there is no input, not one position for each, or the rig has no beam.
    """
    options = options or Options()
    examined = list(examine_many(paths, rig, options, executor=executor))
    return assemble(examined, rig, provenance, options, combined=combined, positions=positions)


def assemble(
    examined: Sequence[Examined],
    rig: Rig,
    provenance: Provenance,
    options: Options,
    *,
    combined: bool = False,
    positions: Positions | None = None,
) -> Report:
    """Return the report of inputs that were examined; see `build`."""
    if not examined:
        raise InputError("a report needs at least one input")
    if positions is not None and len(positions.values) != len(examined):
        raise InputError(f"{len(examined)} inputs need a position each, not {len(positions.values)}")
    file = ReportFile(
        planeopt=__version__,
        provenance=provenance,
        settings=Settings(
            seed=options.seed,
            draws=options.draws,
            robust_dof=options.robust,
            condition_on_rig=options.condition_on_rig,
            both_sides=options.both_sides,
        ),
        prior=options.prior.sentence(rig.require_beam().radius),
        records=tuple(one.record for one in examined),
        summary=summarise(examined, rig, combined=combined, positions=positions),
    )
    return Report(file, _page(file, examined))


def _page(file: ReportFile, examined: Sequence[Examined]) -> Page:
    data = file.to_dict()
    sections: list[Section] = []
    if len(examined) > 1:
        sections.append(batch_section(data, [anchor_of(i + 1) for i in range(len(examined))]))
    sections += [image_section(data, i, one) for i, one in enumerate(examined)]
    sections.append(assumptions(data))
    what = f"{len(examined)} inputs" if len(examined) != 1 else Path(examined[0].input).name
    came = file.provenance
    subtitle = f"Measured with {Path(came.rig_file).name}; planeopt {file.planeopt}, {_readable(came.time)}"
    return Page(f"Plane report: {what}", subtitle, tuple(sections))


def _readable(time: str) -> str:
    return time.replace("T", " ").replace("Z", " UTC")
