"""Counts of where searches ended, and how much they say."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import scipy.stats

from studies.basins_example import DEPTHS, RANDOM, TILTS, EndRow
from studies.basins_rigs import DEFAULT, DISTANCES, RUNS, RigRow
from studies.basins_searches import (
    AT_BOUND,
    BEHIND,
    ELSEWHERE,
    INFEASIBLE,
    NOT_CONVERGED,
    PLANE,
    REFUSED,
    UNSAID,
)

CONFIDENCE = 0.95
"""Of the upper limits, one-sided (Clopper and Pearson)."""


@dataclass(frozen=True)
class ShareRow:
    """Where the searches of one kind ended.

    Attributes
    ----------
    starts : str
        Set of starts: ``"alpha, beta"``, ``"z_L, alpha"`` or ``"random"`` on the worked example; ``"closed form"`` or
        ``"random"`` on random rigs.
    search : str
        Formulation and solver, or the column of `rigs.csv`.
    inequality : {"with", "without"}
    camera, distance : str
        Which of the random rigs; ``"all"`` else. Distances in radii of the beam.
    searches, plane, behind, elsewhere, elsewhere_unsaid, at_bound, not_converged, infeasible, refused : int
    behind_share, behind_upper : float
        Share that ended on the plane behind, and its upper limit at `CONFIDENCE`.
    """

    starts: str
    search: str
    inequality: str
    camera: str
    distance: str
    searches: int
    plane: int
    behind: int
    elsewhere: int
    elsewhere_unsaid: int
    at_bound: int
    not_converged: int
    infeasible: int
    refused: int
    behind_share: float
    behind_upper: float

    @property
    def failed(self) -> int:
        """Searches that ended in no minimum inside the bounds."""
        return self.at_bound + self.not_converged + self.infeasible + self.refused

    @property
    def plane_share(self) -> float:
        return self.plane / self.searches


def upper_limit(successes: int, trials: int) -> float:
    """Largest probability that so few successes leave possible at `CONFIDENCE` (one-sided, Clopper and Pearson)."""
    if successes == trials:
        return 1.0
    return float(scipy.stats.beta.ppf(CONFIDENCE, successes + 1, trials - successes))


def _counted(
    ends: Iterable[str], starts: str, search: str, inequality: str, camera: str = "all", distance: str = "all"
) -> ShareRow:
    counts = Counter(ends)
    n = sum(counts.values())
    in_order = (PLANE, BEHIND, ELSEWHERE, UNSAID, AT_BOUND, NOT_CONVERGED, INFEASIBLE, REFUSED)
    return ShareRow(
        starts,
        search,
        inequality,
        camera,
        distance,
        n,
        *(counts[end] for end in in_order),
        behind_share=counts[BEHIND] / n,
        behind_upper=upper_limit(counts[BEHIND], n),
    )


def example_shares(rows: Sequence[EndRow]) -> list[ShareRow]:
    """Count the ends on the worked example, by set of starts, method and inequality, in the rows' order."""
    kinds = dict.fromkeys((row.method, row.inequality) for row in rows)
    found = []
    for starts in (TILTS, DEPTHS, RANDOM):
        for method, inequality in kinds:
            ends = [r.end for r in rows if (r.starts, r.method, r.inequality) == (starts, method, inequality)]
            if ends:
                found.append(_counted(ends, starts, method, inequality))
    return found


OUTSIDE, NEAR, INSIDE = "outside the beam", "within 5 % of its surface", "inside"
CAMERAS = {"all": (0.0, math.inf), OUTSIDE: (1.05, math.inf), NEAR: (0.95, 1.05), INSIDE: (0.0, 0.95)}
"""Classes of |e|/r, the upper end not among them."""

EDGES = (DISTANCES[0], 10.0, 30.0, 100.0, DISTANCES[1])
"""Of the classes of distance, radii of the beam."""


def rig_shares(rows: Sequence[RigRow]) -> list[ShareRow]:
    """Count the ends on random rigs: all, by where the camera is, and by distance."""
    distances = {"all": (0.0, math.inf), **{f"{a:g} to {b:g}": (a, b) for a, b in pairwise(EDGES)}}
    found = []
    for name in (DEFAULT, *RUNS):
        run = RUNS.get(name)
        starts = "closed form" if run is None or run.closed else "random"
        inequality = "with" if run is None else run.search.inequality
        for (camera, offsets), (distance, depths) in product(CAMERAS.items(), distances.items()):
            ends = [
                getattr(row, name)
                for row in rows
                if getattr(row, name)
                and offsets[0] <= row.offset_over_r < offsets[1]
                and depths[0] <= row.z_L_mm / row.r_mm < depths[1]
            ]
            if ends:
                found.append(_counted(ends, starts, name, inequality, camera, distance))
    return found
