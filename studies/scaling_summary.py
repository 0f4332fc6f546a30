"""The growth of the times in words; every number from the tables."""

from collections.abc import Mapping, Sequence

from studies.scaling_runs import NOISE_PX, POINTS, GrowthRow, TimeRow
from studies.scaling_workers import WorkerRow


def numbers(times: Sequence[TimeRow], grown: Sequence[GrowthRow], workers: Sequence[WorkerRow]) -> dict[str, float]:
    """Return the headline's numbers, from `times.csv`, `growth.csv` and `workers.csv`."""
    batch = _last(times, "frames", "solve_batch")
    closed = _last(times, "frames", "closed form")
    two = next(row for row in workers if row.place == "processes" and row.workers == 2)
    return {
        "frames": batch.size,
        "points_a_frame": POINTS,
        "frames_per_second": round(batch.size / batch.seconds, -2),
        "closed_forms_per_second": round(closed.size / closed.seconds, -4),
        "exponent_frames": _of(grown, "frames", "solve_batch").exponent_at_the_end,
        "exponent_points": _of(grown, "points", "Reprojection + Ipopt").exponent_at_the_end,
        "exponent_views": _of(grown, "views", "joint adjustment").exponent_at_the_end,
        "exponent_walkers": _of(grown, "walkers", "log posterior").exponent_at_the_end,
        "workers": two.workers,
        "speed_up": two.speed_up,
    }


def headline(said: Mapping[str, float]) -> str:
    """Return the answer in a sentence."""
    return (
        f"{said['frames']:,.0f} spots of {said['points_a_frame']:.0f} points become planes at "
        f"{said['frames_per_second']:,.0f} a second on one core, closed forms come at "
        f"{said['closed_forms_per_second']:,.0f}; at the largest sizes time grows as the power "
        f"{said['exponent_frames']:.2f} of the frames, {said['exponent_points']:.2f} of the points of the full "
        f"programme, {said['exponent_views']:.2f} of a calibration's views, {said['exponent_walkers']:.2f} of the "
        f"walkers; {said['workers']:.0f} processes measure images {said['speed_up']:.2f} times as fast as one."
    )


def finding(times: Sequence[TimeRow], grown: Sequence[GrowthRow], workers: Sequence[WorkerRow]) -> str:
    """Return the tables in Markdown with what they mean."""
    lines = [
        "# How the time grows",
        "",
        f"Spots have {POINTS} points unless their number varies, and {NOISE_PX} px of noise; one core, one thread.",
        "",
        "| axis | what | sizes | time of the largest | each | exponent | between the two largest |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in grown:
        last = _last(times, row.axis, row.what)
        lines.append(
            f"| {row.axis} | {row.what} | {row.smallest} to {row.largest} | {1e3 * last.seconds:.3g} ms "
            f"| {last.per_item_us:.3g} us | {row.exponent:.2f} | {row.exponent_at_the_end:.2f} |"
        )
    lines += [
        "",
        "Exponents below one say that what is done once, whatever the size, still counts; one is linear.",
        "",
        "| images by | workers | images | images a second | over one process | start, s | failed |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in workers:
        if row.images_per_second == row.images_per_second:
            cells = f"{row.images_per_second:.1f} | {row.speed_up:.2f} | {row.start_seconds:.1f}"
        else:
            cells = " | | "
        lines.append(f"| {row.place} | {row.workers} | {row.images} | {cells} | {row.failed or '-'} |")
    return "\n".join(lines)


def _last(times: Sequence[TimeRow], axis: str, what: str) -> TimeRow:
    return [row for row in times if (row.axis, row.what) == (axis, what)][-1]


def _of(grown: Sequence[GrowthRow], axis: str, what: str) -> GrowthRow:
    return next(row for row in grown if (row.axis, row.what) == (axis, what))
