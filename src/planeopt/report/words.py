"""What a report says in words: verdicts, captions, what a test can see."""

from enum import Enum

from planeopt.solution import Flag, Status
from planeopt.spot import NoSpotReason, SpotFlag

VERDICTS = {
    "ok": "Good: a plane, and nothing against it.",
    "degraded": "A plane with a reservation: read why before it is used.",
    "refused": "No plane: none can be defended.",
    "error": "This input cannot be used.",
}

OUTSIDE = "outside_image"  # the one flag of a record that no enumeration holds

CAPTIONS = {
    "overlay": (
        "Where there is an image: left, where the spot lies in it. Then the measured boundary points and the ellipse. "
        "Right, the distances of the points from it, magnified. Good: the points lie on the edge between light and "
        "dark, and the lines on the right are of like length all round, pointing in and out at random. Lines that all "
        "point one way over a part of the boundary mean something that is not noise: a shadow, a reflection, a lens "
        "that is not described."
    ),
    "refusal": (
        "The image as it was read, its grey levels stretched; why there is no spot to measure is said above. Good "
        "would be one bright spot, all of it within the image, not over-exposed, and dark surroundings."
    ),
    "residuals": (
        "The same distances in standard deviations, against the angle round the spot. Good: no pattern along the "
        "angle, the mean close to zero, hardly a point beyond two sigma. The sigmas are so large that the points "
        "count as independent, which neighbours are not: a histogram narrower than expected is no fault, a wider one "
        "is."
    ),
    "plane": (
        "Left, the camera, the beam and the plane to scale, in the camera frame. Right, the spot, larger; the cone "
        "holds the normal with 95 %, first order, spot and calibration together. Good: the plane is where it was put, "
        "on the side that the camera sees lit; the cone is narrow. The second plane, where it is drawn, has the same "
        "image, but camera and laser are on two sides of it: its spot would have to be seen from behind."
    ),
    "corner": (
        "Every two of depth and slopes against each other, counted from their medians. Blue: what the sampler found. "
        "Dashed: the Gaussian of first order that sigma describes. Good: the two coincide; then the standard "
        "deviations may be used as they are. Bent or lopsided areas mean that the intervals of the table should be "
        "used instead."
    ),
    "trends": (
        "Depth and angles of each image, with intervals of 95 %; where a dotted line is, there is no value. Good, if "
        "the same plane was seen: the intervals cover one level. A slope means that plane or rig moved; steps single "
        "out the images between which it happened."
    ),
    "chi2": (
        "Left, chi-squared of each image. Right, the same sorted, against what a right rig gives; the numbers are the "
        "images'. Good: within the grey band, close to the line. All of them above the line: the rig is not as it was "
        "calibrated, or the points' sigma is too small. A single one above: look at that image."
    ),
    "quantities": (
        "Value, sigma, spot and calibration: of the solution, its standard deviation of first order and the two parts "
        "of it, whose squares add up; the calibration's is known where the rig's file has a covariance. Median and "
        "intervals: of the posterior. Good: without such a covariance the sigma is half the width of the 68 % "
        "interval. With one the posterior may be much narrower, and anywhere within sigma of the value: the image "
        "says something about the rig too, from which the posterior learns and the solution does not."
    ),
    "comparison": (
        "All formulations with the solvers that suit them, from the same start, without second attempts. Good: "
        "Constrained and Reprojection, which use the points best, agree far within sigma; the others may be off by "
        "some sigmas. AsPrinted is always refused: the ten equations as they stand have no solution to be searched "
        "for."
    ),
}

SHORT = (
    "This tests whether any plane gives the ellipse: the direction of the beam as the camera sees it, the direction "
    "of its offset, and the offset over the radius. It never sees the focal length or the scale."
)
SEES = (
    "What chi-squared can see: whether any plane at all gives the ellipse that was measured. The images of one beam "
    "all touch the same two lines, and this is what is tested, with 2 degrees of freedom: it answers to the direction "
    "of the beam as the camera sees it, to the direction of its offset e, and to |e|/r."
)
BLIND = (
    "What it cannot see, however many images there are: the focal length (f -> k f gives (z_L, p, q) -> k (z_L, p, q) "
    "with the same chi-squared), the metric scale, and the principal point apart from the beam's direction. A rig "
    "that is wrong in these gives wrong planes with a perfect chi-squared; only a board can tell."
)


def verdict(status: str, *, flagged: bool) -> str:
    """Return what a record's status means; `flagged`: there is something to know about it."""
    return "A plane; what should be known about it is listed below." if status == "ok" and flagged else VERDICTS[status]


def flag_sentence(name: str, status: str) -> str:
    """Return the sentence of a record's flag.

    Parameters
    ----------
    name : str
        As in the record, lower case.
    status : {"ok", "degraded", "refused", "error"}
        Of the record: the same name may stand for a reason why there is no spot and for a remark about one.
    """
    if name == OUTSIDE:
        return "Boundary points lie outside the camera's image."
    kinds: tuple[type[Enum], ...] = (Status, Flag, SpotFlag)
    for kind in (NoSpotReason, *kinds) if status == "refused" else kinds:
        if name.upper() in kind.__members__:
            return str(kind[name.upper()].value)
    return name


def number(value: float, sigma: float | None) -> str:
    """Return a number to the second digit of its standard deviation; to four decimals where there is none."""
    return fixed(value, decimals(sigma))


def fixed(value: float, places: int) -> str:
    """Return a number with so many decimals, a zero without a sign."""
    text = f"{value:.{places}f}"
    return text.lstrip("-") if float(text) == 0 else text


def decimals(sigma: float | None) -> int:
    """Return how many decimals a number with this standard deviation deserves: two digits of it, at most nine."""
    if sigma is None or sigma <= 0:
        return _USUAL_DECIMALS
    power = int(f"{sigma:.1e}".partition("e")[2])
    return min(max(1 - power, 0), _MOST_DECIMALS)


_USUAL_DECIMALS, _MOST_DECIMALS = 4, 9


def p_text(value: float) -> str:
    """Return a p-value: three decimals, or the power of ten where these say nothing."""
    if value == 0:
        return "0"  # smaller than any number
    return f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"
