"""What the basins study says, made from its tables."""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from planeopt import paper
from studies.basins_example import DEPTHS_MM, FINE, RANDOM, SIGMA_MM, TILTS, EndRow
from studies.basins_rigs import (
    DEFAULT,
    DISTANCES,
    FIELD,
    FOCAL_MM,
    N_POINTS,
    NOISES,
    OFFSETS,
    RADII_MM,
    RUNS,
    TILT_DEG,
    RigRow,
)
from studies.basins_searches import AT_ONCE, BEHIND, ENDS, FAST, OBVIOUS, PLANE, SLOW
from studies.basins_summary import CONFIDENCE, EDGES, INSIDE, NEAR, OUTSIDE, ShareRow

CONSTRAINED, PAPER_VARIABLES = (search.method for search in FAST[:2])
NEAREST = f"{EDGES[0]:g} to {EDGES[1]:g}"
"""The class of distances where the plane behind is least steep."""


def from_papers_start(rows: Sequence[EndRow]) -> dict[tuple[str, str], str]:
    """Return where each search ended from the paper's own start, by method and inequality."""
    R, z_L, _, _ = paper.START
    return {
        (row.method, row.inequality): row.end
        for row in rows
        if row.starts == TILTS and (row.start_R_mm, row.start_z_L_mm) == (R, z_L) and _is_papers(row)
    }


def _is_papers(row: EndRow) -> bool:
    return (row.start_alpha_deg, row.start_beta_deg) == (20.0, 20.0)


def share(shares: Sequence[ShareRow], starts: str, search: str, inequality: str) -> ShareRow:
    """Return the row of the worked example that has these."""
    return next(s for s in shares if (s.starts, s.search, s.inequality) == (starts, search, inequality))


def rig_share(shares: Sequence[ShareRow], search: str, camera: str = "all", distance: str = "all") -> ShareRow | None:
    """Return the row of the random rigs that has these, None where there was no such rig."""
    wanted = (search, camera, distance)
    return next((s for s in shares if (s.search, s.camera, s.distance) == wanted), None)


def total(shares: Sequence[ShareRow], search: str) -> ShareRow:
    """Return the row of a search on all random rigs it was run on."""
    found = rig_share(shares, search)
    if found is None:
        raise ValueError(f"no rig was searched by {search}")
    return found


class Numbers(dict[str, float]):
    """Numbers of the headline, kept as they are said."""

    def say(self, name: str, text: str) -> str:
        """Keep a number under a name and return its text."""
        self[name] = float(text)
        return text


def headline(
    ends: Sequence[EndRow], shares: Sequence[ShareRow], of_rigs: Sequence[ShareRow]
) -> tuple[str, Mapping[str, float]]:
    """Say it in a few sentences, and return the numbers that are in them."""
    n, papers = Numbers(), from_papers_start(ends)
    free, kept = ({m: e for (m, i), e in papers.items() if i == which} for which in ("without", "with"))
    random = {i: share(shares, RANDOM, CONSTRAINED, i) for i in ("without", "with")}
    solve, cold = total(of_rigs, DEFAULT), total(of_rigs, "random_ipopt_without")
    near = rig_share(of_rigs, "random_ipopt_without", OUTSIDE, NEAREST)
    behind = _count(free, BEHIND)
    obvious = " (that of the programme without any inequality)" if free[OBVIOUS.method] == BEHIND else ""
    said = (
        f"Of {n.say('paper_start_without_searches', str(len(free)))} searches from the paper's own start without the "
        f"inequality of visibility {n.say('paper_start_without_behind', str(behind))} "
        f"{'ends' if behind == 1 else 'end'} on the plane behind{obvious}, of "
        f"{n.say('paper_start_with_searches', str(len(kept)))} with it "
        f"{n.say('paper_start_with_behind', str(_count(kept, BEHIND)))}; from "
        f"{n.say('random_starts', str(random['without'].searches))} random starts `Constrained` with Ipopt does so in "
        f"{n.say('random_without_behind_percent', _percent(random['without'].behind_share))} % without it and in "
        f"{n.say('random_with_behind_percent', _percent(random['with'].behind_share))} % with it. Over "
        f"{n.say('rigs', str(solve.searches))} random rigs and planes `planeopt.solve`, which has it and begins at the "
        f"closed form, ends on the plane behind in {n.say('solve_behind', str(solve.behind))} (the probability is "
        f"under {n.say('solve_behind_upper_percent', f'{100 * solve.behind_upper:.2g}')} % at "
        f"{n.say('confidence_percent', f'{100 * CONFIDENCE:.0f}')} % confidence) and on the plane in "
        f"{n.say('solve_plane', str(solve.plane))}; without it and from random starts "
        f"{n.say('cold_without_behind_percent', _percent(cold.behind_share))} % of the searches end behind"
    )
    if near is None:
        return f"{said}.", n
    said += (
        f", {n.say('cold_without_near_behind_percent', _percent(near.behind_share))} % where the camera is outside the "
        f"beam and the spot nearer than {n.say('near_distance_radii', f'{EDGES[1]:g}')} radii."
    )
    return said, n


def _count(ends: Mapping[str, str], end: str) -> int:
    return sum(value == end for value in ends.values())


def _percent(part: float) -> str:
    return f"{100 * part:.1f}"


def finding(
    ends: Sequence[EndRow], shares: Sequence[ShareRow], rigs: Sequence[RigRow], of_rigs: Sequence[ShareRow]
) -> str:
    """Say what was found; every number comes from the tables."""
    return "\n\n".join(
        [
            "# Where searches end",
            headline(ends, shares, of_rigs)[0],
            "## The worked example, from the paper's start",
            "`ends.csv`, start (10 mm, 250 mm, 20 deg, 20 deg).",
            "\n".join(_papers_table(ends)),
            "## The worked example, from random starts",
            _random_starts(shares),
            "\n".join(_example_table([s for s in shares if s.starts == RANDOM])),
            _stages(shares),
            "## Random rigs and planes",
            _drawn(rigs),
            "\n".join(_rigs_table(of_rigs)),
            _where(of_rigs),
            _from_closed_form(rigs, of_rigs),
            "## What counts as what",
            _definitions(),
        ]
    )


def _papers_table(ends: Sequence[EndRow]) -> Iterator[str]:
    papers = from_papers_start(ends)
    yield "| formulation and solver | without the inequality | with it |"
    yield "|---|---|---|"
    for method in dict.fromkeys(method for method, _ in papers):
        yield f"| {method} | {papers[method, 'without']} | {papers.get((method, 'with'), 'has none')} |"


_COUNTS = "plane | behind | elsewhere | elsewhere unsaid | at bound | not converged | infeasible | refused"


def _counts(s: ShareRow) -> str:
    values = (s.plane, s.behind, s.elsewhere, s.elsewhere_unsaid, s.at_bound, s.not_converged, s.infeasible, s.refused)
    return " | ".join(str(value) for value in values)


def _example_table(shares: Sequence[ShareRow]) -> Iterator[str]:
    yield f"| formulation and solver | inequality | starts | {_COUNTS} |"
    yield "|---|---|---|" + 8 * "---|"
    for s in shares:
        yield f"| {s.search} | {s.inequality} | {s.searches} | {_counts(s)} |"


def _random_starts(shares: Sequence[ShareRow]) -> str:
    fine, coarse = (share(shares, RANDOM, method, "with").searches for method in (CONSTRAINED, SLOW[0].method))
    return (
        f"`shares.csv`. R is 5 to 100 mm, z_L {DEPTHS_MM[0]:g} to {DEPTHS_MM[1]:g} mm (logarithmic), alpha 0 to "
        f"{TILT_DEG:g} deg, beta any. Searches that take long get the first {coarse} of the {fine} starts."
    )


def _stages(shares: Sequence[ShareRow]) -> str:
    staged, in_paper = (share(shares, RANDOM, search.method, "with") for search in FAST[:2])
    at_once, paper_at_once = (share(shares, RANDOM, search.method, "with") for search in AT_ONCE)
    return (
        f"**The mild stage.** With the inequality and Ipopt, `Constrained` reaches the plane from "
        f"{_percent(staged.plane_share)} % of the random starts when the mild weights come first and from "
        f"{_percent(at_once.plane_share)} % with the final weights at once; in the paper's variables from "
        f"{_percent(in_paper.plane_share)} % and {_percent(paper_at_once.plane_share)} %."
    )


def _drawn(rigs: Sequence[RigRow]) -> str:
    return (
        f"{len(rigs)} rigs (`rigs.csv`): |e|/r from 0 to {OFFSETS:g} on all sides, two fifths of the cameras outside "
        "the beam, a fifth within 5 % of its surface, two fifths inside, some of them on its axis; focal lengths "
        f"{FOCAL_MM[0]:g} to {FOCAL_MM[1]:g} mm, radii {RADII_MM[0]:g} to {RADII_MM[1]:g} mm, distances "
        f"{DISTANCES[0]:g} to {DISTANCES[1]:g} radii, tilts to {TILT_DEG:g} deg, the whole spot before the camera "
        f"within {math.degrees(math.atan(FIELD)):.0f} deg of the optical axis, its lit side facing it; {N_POINTS} "
        f"points with noise of {NOISES[0]:g} to {NOISES[1]:g} of the image ellipse's shorter semi-axis. Random starts "
        "are as above, in radii, to twice the largest distance. The limit is the largest share on the plane behind "
        f"that {100 * CONFIDENCE:.0f} % confidence leaves possible (one-sided, Clopper and Pearson)."
    )


def _rigs_table(shares: Sequence[ShareRow]) -> Iterator[str]:
    yield f"| search | inequality | start | rigs | {_COUNTS} | behind, % | limit, % |"
    yield "|---|---|---|---|" + 10 * "---|"
    for name in (DEFAULT, *RUNS):
        s = total(shares, name)
        called = f"planeopt.solve ({CONSTRAINED})" if name == DEFAULT else RUNS[name].search.method
        yield (
            f"| {called} | {s.inequality} | {s.starts} | {s.searches} | {_counts(s)} | {100 * s.behind_share:.2g} | "
            f"{100 * s.behind_upper:.2g} |"
        )


def _where(shares: Sequence[ShareRow]) -> str:
    parts = []
    for camera in (OUTSIDE, NEAR, INSIDE):
        found = rig_share(shares, "random_ipopt_without", camera)
        if found is not None:
            parts.append(f"{found.behind} of {found.searches} with the camera {camera}")
    by_distance = [
        f"{s.behind} of {s.searches} at {s.distance} radii"
        for s in shares
        if (s.search, s.camera) == ("random_ipopt_without", OUTSIDE) and s.distance != "all"
    ]
    return (
        "**Where.** Without the inequality and from random starts the search of `Constrained` with Ipopt ends behind "
        f"in {', '.join(parts)}. Outside the beam it is {', '.join(by_distance)} (`rig_shares.csv`). Inside the beam "
        "the second plane lies behind the camera, and the inequality that the spot is in front excludes it."
    )


def _from_closed_form(rigs: Sequence[RigRow], shares: Sequence[ShareRow]) -> str:
    lost = [row for row in rigs if row.reasons]
    runs = {name: total(shares, name) for name in (DEFAULT, *(n for n, run in RUNS.items() if run.closed))}
    failed = {name: s.searches - s.plane for name, s in runs.items() if s.searches > s.plane}
    told = ", ".join(f"{name} in {count}" for name, count in failed.items()) or "none in any"
    examples = "".join(f"\n- rig {row.rig}, {row.reasons}" for row in lost[:_SHOWN])
    tail = f"; the first of them:\n{examples}" if lost else "."
    squared = np.array([row.error_sigmas for row in rigs if not math.isnan(row.error_sigmas)]) ** 2
    errors = (
        f"The planes of `planeopt.solve` are off the true ones by {np.mean(squared) / 3:.3f} times their covariance "
        f"(mean square over the 3 degrees of freedom), by {np.sqrt(np.max(squared)):.2f} standard deviations at most "
        "(`error_sigmas`). "
    )
    return f"{errors}**From the closed form** not at the plane: {told} (column `reasons` of `rigs.csv`){tail}"


_SHOWN = 10


def _definitions() -> str:
    grid = FINE["full"]
    words = "".join(f"\n- `{name}`: {meaning};" for name, meaning in ENDS.items())
    return (
        f"A search's end is one of\n{words}\n\nOptimality is recomputed, whatever the solver says. `without` leaves "
        "out `c > 0` and nothing else (`planeopt.EitherSide`): that the spot is in front of the camera and the bounds "
        f"remain. `{OBVIOUS.method}` is the programme that the ten equations suggest: residuals of (17)-(21) over "
        "|B_i|, squared, R cos(alpha) = r hard, no inequality, bound or scaling at all. The example's points are "
        f"exact; weights are those of noise of {SIGMA_MM:g} mm. The maps pass through the paper's start: alpha 0 to "
        f"{max(grid.alphas_deg):g} deg by 5, beta by 20, depths by half octaves, coarser for the searches that take "
        "long. From a given start "
        f"`Constrained` solves with mild weights first unless it says `at once`. A plane counts as `{PLANE}` or "
        f"`{BEHIND}` where its ellipse agrees with the measured one, or it is as near to the true plane, or the one "
        "behind that, as its own covariance allows (both at a probability of 1e-9)."
    )
