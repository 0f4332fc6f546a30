"""The model of a blurred edge or ridge, fitted to the pixels of the band round a spot.

One blur round the spot, a plateau and a background that vary smoothly across it, and a boundary that departs from the
ellipse by a few waves: all by weighted least squares (Gauss-Newton). Clipped pixels tell nothing and have no weight.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray
from scipy.stats import chi2

from planeopt.spot.band import Band
from planeopt.spot.blurred import curved, is_gentle, profile, rendered
from planeopt.spot.points import Kind
from planeopt.spot.surfaces import surface, surface_slope, waves

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ELLIPSE_WAVES = 2  # of the boundary's offset: what an ellipse can do, to first order
_LEAST_VARIANCE = 0.04  # px^2: a pixel alone blurs more
_SHARE, _SHARE_SIGMA = 0.5, 0.3  # of a ring's width that is blur, where the picture does not tell: anything from 0 to 1
_N_ELLIPSE = 2 * _ELLIPSE_WAVES + 1
_CHANCE = 0.02  # with which a variation that is not there is taken for one
_MEDIAN_OF_SQUARE = 0.4549  # of a standard normal variable
_LEAN_SIGMA, _MOST_LEAN = 0.3, 0.6
_CLASSES = 12  # of height, in which the noise is looked at
_SETTLED = 1e-4  # of the width: a smaller step changes nothing


@dataclass(frozen=True)
class Widths:
    """How wide the profile is: variances in px^2.

    Parameters
    ----------
    blur : float
        Of the camera, pixel included: the same all round; it moves a curved boundary.
    line : float
        Of the beam's own edge or line, at the ellipse's mean size; it moves nothing.
    lean : (float, float)
        By which share the beam's own scale is larger than that of a concentric ellipse, times cosine and sine of the
        eccentric angle: perspective, which makes what is nearer wider.
    """

    blur: float
    line: float = 0.0
    lean: tuple[float, float] = (0.0, 0.0)

    @property
    def mean(self) -> float:
        """Standard deviation of the profile, px, where the beam's own scale is the mean one."""
        return float(np.sqrt(self.blur + self.line))

    def total(self, scale: Array) -> Array:
        """Return the standard deviation (M,), px, where the beam's own scale is `scale` (M,) times the mean."""
        return np.sqrt(self.blur + self.line * scale**2)


@dataclass(frozen=True)
class Freedom:
    """What is free in the fit.

    Parameters
    ----------
    waves : int
        Of the boundary's offset from the ellipse.
    plateau, background : int
        Degree of the surfaces.
    plateau_waves, background_waves : int
        Highest multiple of the angle in which they vary besides.
    plateau_slopes, background_slopes : bool
        Whether their slopes across the boundary are free in the waves that an ellipse has.
    blur, line, lean : bool
        Whether these parameters of the widths are free.
    """

    waves: int
    plateau: int
    background: int
    plateau_waves: int
    background_waves: int
    plateau_slopes: bool
    background_slopes: bool
    blur: bool
    line: bool
    lean: bool

    @property
    def background_terms(self) -> int:
        """Number of the background's coefficients: level, polynomial, waves, slopes, in this order."""
        return _count(self.background, self.background_waves, self.background_slopes)

    @property
    def groups(self) -> list[slice]:
        """Where among the surfaces' coefficients are those that a spot may not need: slopes, then all but the level."""
        found = []
        for first, (degree, highest, slopes) in (
            (0, (self.background, self.background_waves, self.background_slopes)),
            (self.background_terms, (self.plateau, self.plateau_waves, self.plateau_slopes)),
        ):
            end = first + _count(degree, highest, slopes)
            middle = end - _N_ELLIPSE * slopes
            found += [slice(middle, end)] * slopes + [slice(first + 1, middle)] * (middle > first + 1)
        return sorted(found, key=lambda group: group.stop - group.start == _N_ELLIPSE, reverse=True)


def _count(degree: int, highest: int, slopes: bool) -> int:
    return 1 + 2 * max(degree, highest) + _N_ELLIPSE * slopes


@dataclass(frozen=True, eq=False)
class Model:
    """A fitted band.

    Parameters
    ----------
    kind : {"disc", "ring"}
    freedom : Freedom
    widths : Widths
    offset : array
        Coefficients of the boundary's waves, px.
    surface : array
        Coefficients of the background, then of the plateau, shares of full scale.
    noise : (3,) array
        Variance of a pixel: of the background, by the height over it, by that height squared.
    """

    kind: Kind
    freedom: Freedom
    widths: Widths
    offset: Array
    surface: Array
    noise: Array

    @property
    def plateau_height(self) -> float:
        """Of the plateau over the background at the spot's centre (of the ridge: its mean), share of full scale."""
        height = float(self.surface[self.freedom.background_terms])
        # A ring's light is that of a line of unit stretch, whose peak is lower the wider it is.
        return height / self.widths.mean if self.kind == "ring" else height


@dataclass(frozen=True, eq=False)
class Terms:
    """What of the model does not change while it is fitted; M pixels.

    Parameters
    ----------
    u, curvature, values : (M,) array
        As in `Band`.
    stretch : (M,) array
        By how much more than on average the beam's own scale is stretched across the boundary.
    boundary : (n, M) array
        Waves of the boundary's offset.
    ground, top, slope : (n, M) array
        Background; plateau; the plateau's derivative across the boundary, 1/px.
    rest : (M,) array
        What the rendered profile has more than the analytic one.
    """

    u: Array
    curvature: Array
    values: Array
    stretch: Array
    boundary: Array
    ground: Array
    top: Array
    slope: Array
    rest: Array

    def part(self, keep: Mask) -> "Terms":
        """Return the terms of these pixels (M,) alone."""
        return Terms(*(np.compress(keep, getattr(self, field.name), axis=-1) for field in fields(self)))


@dataclass(frozen=True, eq=False)
class Seen:
    """A model in the pixels of a band; M pixels.

    Parameters
    ----------
    value : (M,) array
    height : (M,) array
        Of the value over the background.
    position : (M,) array
        Derivative by the boundary's place, px outwards.
    level, slope : (M,) array
        Of the profile; `slope` inwards, 1/px.
    by_widths : (4, M) array
        Derivatives by the variances of blur and line, and by the two leans.
    """

    value: Array
    height: Array
    position: Array
    level: Array
    slope: Array
    by_widths: Array


def terms_of(band: Band, kind: Kind, free: Freedom, widths: Widths) -> Terms:
    """Return the terms of a band for a model of these freedoms, its profile rendered with these widths."""
    c, s = np.cos(band.theta), np.sin(band.theta)
    stretch = 1.0 / (np.hypot(c / band.outline.a, s / band.outline.b) * band.outline.size)
    all_waves = waves(band.theta, max(free.waves, free.background_waves, free.plateau_waves))
    ground, _ = _surface(band, all_waves, free.background, free.background_waves, free.background_slopes)
    top, slope = _surface(band, all_waves, free.plateau, free.plateau_waves, free.plateau_slopes)
    return Terms(
        u=band.u,
        curvature=band.curvature,
        values=band.values,
        stretch=stretch,
        boundary=all_waves[: 2 * free.waves + 1],
        ground=ground,
        top=top,
        slope=slope,
        rest=_remainder(band, kind, widths, stretch),
    )


def _surface(band: Band, all_waves: Array, degree: int, highest: int, slopes: bool) -> tuple[Array, Array]:
    """Return the terms (n, M) of a surface, and their derivatives (n, M) across the boundary, 1/px."""
    size = band.outline.size
    wavy = all_waves[2 * degree + 1 : 2 * highest + 1]
    rising = all_waves[:_N_ELLIPSE] / size if slopes else all_waves[:0]
    value = [surface(band.places, degree), wavy, rising * band.u]
    slope = [surface_slope(band.places, band.normals.T, degree) / size, np.zeros_like(wavy), rising]
    return np.concatenate(value), np.concatenate(slope)


def _remainder(band: Band, kind: Kind, widths: Widths, stretch: Array) -> Array:
    blur, line = float(np.sqrt(widths.blur)), float(np.sqrt(widths.line))
    if is_gentle(kind, band.outline, widths.mean):
        return np.zeros(len(band.u))
    level, _, _ = _profile(kind, band.u, band.curvature, stretch, stretch, widths)
    return rendered(kind, band.outline, blur, line, band.box)[band.rows, band.columns] - level


def _profile(
    kind: Kind, u: Array, curvature: Array, stretch: Array, scale: Array, widths: Widths
) -> tuple[Array, Array, tuple[Array, Array]]:
    """Return the profile (M,), its slope inwards, and its derivatives by the variances of the blur and of the line.

    Parameters
    ----------
    kind, u, curvature
    stretch : (M,) array
        By how much more than on average a concentric ellipse's scale is stretched across the boundary.
    scale : (M,) array
        The same for the beam's own.
    widths : Widths
    """
    width = widths.total(scale)
    moved = curved(u, curvature, 1.0)
    x = u + moved * np.clip(widths.blur, 0.0, width**2)
    level, slope = profile(kind, x, width)
    widening = slope * x / width
    if kind == "ring":
        # The same light in a line that is wider by its own scale, and lower as it is blurred. Where its scale leans the
        # plateau's waves make up for it.
        peak = stretch / width
        widening = peak * (widening - level / width)
        level, slope = peak * level, peak * slope
    widening = widening / (2 * width)
    return level, slope, (widening - slope * moved, widening)


def see(terms: Terms, model: Model) -> Seen:
    """Return the model in the pixels of some terms."""
    u = terms.u - model.offset @ terms.boundary
    turn = terms.boundary[1:3]
    scale = terms.stretch * (1 + np.array(model.widths.lean) @ turn)
    level, slope, (by_blur, by_line) = _profile(model.kind, u, terms.curvature, terms.stretch, scale, model.widths)
    level = level + terms.rest
    split = model.freedom.background_terms
    plateau = model.surface[split:] @ terms.top
    # A plateau with a slope, blurred: the product of both, and by Stein's identity blur^2 times the product of slopes.
    height = plateau * level - (model.surface[split:] @ terms.slope) * (model.widths.blur * slope)
    return Seen(
        value=model.surface[:split] @ terms.ground + height,
        height=height,
        position=plateau * slope,
        level=level,
        slope=slope,
        by_widths=plateau
        * np.stack([by_blur, by_line * scale**2, *(by_line * (2 * model.widths.line * scale * terms.stretch) * turn)]),
    )


def _design(terms: Terms, model: Model, seen: Seen) -> Array:
    """Return the derivatives (n, M) by the coefficients of background and plateau."""
    top = terms.top * seen.level - terms.slope * (model.widths.blur * seen.slope)
    return np.concatenate([terms.ground, top])


def variance(model: Model, seen: Seen) -> Array:
    """Return the variance of each pixel's noise (M,)."""
    height = np.maximum(seen.height, 0.0)
    return model.noise[0] + model.noise[1] * height + model.noise[2] * height**2


def noise_law(seen: Seen, residual: Array) -> Array:
    """Return the variance of a pixel's noise as a polynomial (3,) of its height over the background, none negative.

    By non-negative least squares on the median squared residual in classes of height, whatever a few segments see that
    is not the spot; a class counts by how well its noise is known, which is in proportion to the variance itself. Read
    noise, shot noise and speckle are its three terms.
    """
    classes = np.array_split(np.argsort(seen.height), _CLASSES)
    height = np.maximum(np.array([seen.height[members].mean() for members in classes]), 0.0)
    mean = np.array([np.median(residual[members] ** 2) for members in classes]) / _MEDIAN_OF_SQUARE
    mean = np.maximum(mean, max(1e-4 * float(mean.max()), 1e-14))
    basis = np.stack([np.ones_like(height), height, height**2], axis=1)
    expected, law = mean, np.zeros(3)
    for _ in range(3):
        law = scipy.optimize.nnls(basis / expected[:, None], mean / expected)[0]
        law[0] = max(law[0], 0.01 * float(mean.min()))
        expected = basis @ law
    return law


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted model and what the pixels say about it.

    Parameters
    ----------
    model : Model
    information : (n, n) array
        Of the boundary's waves, the surfaces' coefficients and the free variances, in this order.
    """

    model: Model
    information: Array

    def shared_inflation(self, times: float) -> float:
        """By how much what all points share makes the ellipse less certain than each point's own noise says.

        The variance with everything else free over that with everything else known, midway between its mean over the
        changes that an ellipse can make and its largest: one number for all of them. It is the size that has the
        largest; the others are taken for somewhat less certain than they are, it for somewhat more.

        Parameters
        ----------
        times : float
            How many times more points there are than were fitted here: what is shared is known no better for them.
        """
        n, places = _N_ELLIPSE, self._shared
        ellipse, shared = self.information[:n, :n], self.information[np.ix_(places, places)]
        mixed = self.information[:n, places]
        left = ellipse - mixed @ solve(shared, mixed.T)
        ratios = 1 / np.maximum(scipy.linalg.eigh(left, ellipse, eigvals_only=True), 1e-6)
        ratios = 1 + times * (ratios - 1)
        return float(np.sqrt((ratios.mean() + ratios.max()) / 2))

    def pruned(self) -> "Fitted":
        """Return the fit without those variations of background and plateau that are not needed.

        Slopes across the boundary, above all, say nearly the same as its place does: to have them free costs half of
        what is known about it, and to leave them out where they are needed moves it. A group goes where all of it
        together is what noise makes of none in 49 cases of 50; the other parameters follow as in a fit without it,
        to first order.
        """
        fit = self
        for place in self.model.freedom.groups:
            fit = fit._without(place)
        return fit

    def _without(self, place: slice) -> "Fitted":
        model, first = self.model, len(self.model.offset)
        gone = np.arange(first + place.start, first + place.stop)
        kept = np.setdiff1d(np.flatnonzero(np.diag(self.information) > 0), gone)
        rest, mixed = self.information[np.ix_(kept, kept)], self.information[np.ix_(kept, gone)]
        value = model.surface[place]
        through = solve(rest, mixed)
        left = self.information[np.ix_(gone, gone)] - mixed.T @ through
        if float(value @ left @ value) > chi2.isf(_CHANCE, len(gone)):
            return self
        change = np.zeros(len(self.information))
        change[kept], change[gone] = through @ value, -value
        # An information of nought stands for what has gone.
        information = self.information.copy()
        information[gone] = information[:, gone] = 0.0
        return Fitted(_moved(model, change)[0], information)

    @property
    def _shared(self) -> NDArray[np.intp]:
        """Places of what all points share, among all parameters."""
        first = len(self.model.offset)
        return first + np.flatnonzero(np.diag(self.information)[first:] > 0)

    @property
    def blur_sigma(self) -> float:
        """Standard deviation of the blur's variance, px^2; 0 where it is given."""
        if not self.model.freedom.blur:
            return 0.0
        places = np.concatenate([np.arange(_N_ELLIPSE), self._shared])
        place = len(places) - int(self.model.freedom.line) - 2 * int(self.model.freedom.lean) - 1
        return float(np.sqrt(np.diag(np.linalg.inv(self.information[np.ix_(places, places)]))[place]))


def solve(matrix: Array, right: Array) -> Array:
    """Return the solution of normal equations; what they do not determine stays nought."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-12 * float(np.trace(matrix)) + 1e-300))
    tamed = matrix * scale * scale[:, None] + 1e-12 * np.eye(len(scale))
    return (scale * np.linalg.solve(tamed, (scale * right.T).T).T).T


def fit_model(terms: Terms, model: Model, *, steps: int) -> Fitted:
    """Fit a model to pixels, from a start whose `surface` does not matter.

    Parameters
    ----------
    terms : Terms
        Of the pixels that count.
    model : Model
        Start: its widths, offset and noise.
    steps : int
        Of Gauss-Newton, at most.
    """
    model = replace(model, surface=np.zeros(len(terms.ground) + len(terms.top)))
    design = _design(terms, model, see(terms, model))
    model = replace(model, surface=solve(design @ design.T, design @ terms.values))
    information = np.eye(1)
    for step in range(steps):
        information, right = _normal_equations(terms, model)
        change = solve(information, right)
        model, size = _moved(model, change)
        if step > 0 and size < _SETTLED:
            break
    return Fitted(model, information)


def _normal_equations(terms: Terms, model: Model) -> tuple[Array, Array]:
    seen = see(terms, model)
    root = 1 / np.sqrt(variance(model, seen))
    rows = [seen.position * terms.boundary, _design(terms, model, seen)]
    free = model.freedom
    rows.append(seen.by_widths[np.array([free.blur, free.line, free.lean, free.lean])])
    jacobian = np.concatenate(rows) * root
    information, right = jacobian @ jacobian.T, jacobian @ ((terms.values - seen.value) * root)
    if free.blur and free.line:
        total = model.widths.blur + model.widths.line
        row, first = np.zeros(len(right)), len(model.offset) + len(model.surface)
        row[first : first + 2] = np.array([1 - _SHARE, -_SHARE]) / (_SHARE_SIGMA * total)
        information += np.outer(row, row)
        right -= row * (row[first] * model.widths.blur + row[first + 1] * model.widths.line)
    if free.lean:
        # Perspective is not stronger than this in any rig that sees its spot whole; without a line nothing tells.
        ends = np.arange(len(right) - 2, len(right))
        information[ends, ends] += 1 / _LEAN_SIGMA**2
        right[ends] -= np.array(model.widths.lean) / _LEAN_SIGMA**2
    return information, right


def _moved(model: Model, change: Array) -> tuple[Model, float]:
    """Return the model a step further, and how far that is in units of its width."""
    n, m = len(model.offset), len(model.offset) + len(model.surface)
    widths, rates = model.widths, list(change[m:])
    total = widths.blur + widths.line
    size = float(np.abs(change[:n]).sum()) / np.sqrt(total)
    # Beyond its own width a profile tells nothing about where it is.
    damping = min(1.0, 1.0 / max(size, 1e-12))
    blur, line, lean = widths.blur, widths.line, widths.lean
    if model.freedom.blur:
        blur = max(blur + float(np.clip(rates.pop(0), -0.5 * total, total)), _LEAST_VARIANCE)
    if model.freedom.line:
        line = max(line + float(np.clip(rates.pop(0), -0.5 * total, total)), 0.0)
    if model.freedom.lean:
        lean = tuple(float(v) for v in np.clip(np.add(lean, rates), -_MOST_LEAN, _MOST_LEAN))
    moved = replace(
        model,
        widths=Widths(blur, line, (lean[0], lean[1])),
        offset=model.offset + damping * change[:n],
        surface=model.surface + change[n:m],
    )
    return moved, max(size, abs(blur - widths.blur) / total, abs(line - widths.line) / total)


@dataclass(frozen=True, eq=False)
class Segments:
    """What each segment of the boundary says by itself; S segments.

    Parameters
    ----------
    offset : (S,) array
        Of the boundary from the model's, px outwards: one weighted least-squares step.
    variance : (S,) array
        Of `offset`, px^2; infinite where nothing is known.
    misfit : (S,) array
        Mean squared residual over the expected variance.
    theta : (S,) array
        Eccentric angle of what was seen, weighted by what it says about the place.
    """

    offset: Array
    variance: Array
    misfit: Array
    theta: Array


def segments_of(band: Band, terms: Terms, model: Model, keep: Mask) -> Segments:
    """Return what the kept pixels (M,) of each segment say about the boundary's place, all else being the model's."""
    seen = see(terms, model)
    weight = keep / variance(model, seen)
    residual = terms.values - seen.value
    power, n = weight * seen.position**2, band.count
    information = np.bincount(band.segment, power, n)
    known = information > 0
    safe = np.where(known, information, 1.0)
    pixels = np.maximum(np.bincount(band.segment, keep.astype(np.float64), n), 1.0)
    # The first segment begins at angle 0: none holds the jump from 2 pi to it.
    theta = np.bincount(band.segment, power * np.mod(band.theta, 2 * np.pi), n) / safe
    return Segments(
        offset=np.bincount(band.segment, weight * seen.position * residual, n) / safe,
        variance=np.where(known, 1 / safe, np.inf),
        misfit=np.bincount(band.segment, weight * residual**2, n) / pixels,
        theta=theta,
    )
