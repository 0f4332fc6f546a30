"""The model of a blurred edge or ridge in the pixels of the band round a spot.

One blur round the spot, a plateau and a background that vary smoothly across it, and a boundary that departs from the
ellipse by a few waves.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.band import Band
from planeopt.spot.blurred import curved, is_gentle, profile, rendered
from planeopt.spot.points import Kind
from planeopt.spot.surfaces import surface, surface_slope, waves_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ELLIPSE_WAVES = 2
"""Of the boundary's offset: what an ellipse can do, to first order."""

N_ELLIPSE = 2 * ELLIPSE_WAVES + 1
"""Number of the coefficients of these waves."""


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
    oval : (float, float)
        By which share the blur's variance is larger across the boundary, times cosine and sine of twice the direction
        of its normal, and smaller along it: motion, astigmatism.
    """

    blur: float
    line: float = 0.0
    lean: tuple[float, float] = (0.0, 0.0)
    oval: tuple[float, float] = (0.0, 0.0)

    @property
    def mean(self) -> float:
        """Standard deviation of the profile, px, where the beam's own scale is the mean one."""
        return float(np.sqrt(self.blur + self.line))

    def turned(self, by: float) -> "Widths":
        """Return the same, told from a major axis whose direction is `by` more, rad, of an ellipse nearly the same."""
        c, s = float(np.cos(by)), float(np.sin(by))
        x, y = self.lean
        return replace(self, lean=(c * x + s * y, c * y - s * x))

    def total(self, scale: Array, stretched: Array | float = 0.0) -> Array:
        """Return the standard deviation (M,), px.

        Parameters
        ----------
        scale : (M,) array
            The beam's own scale over its mean.
        stretched : (M,) array
            Share by which the blur's variance is larger across the boundary than on average.
        """
        return np.sqrt(self.blur * (1 + stretched) + self.line * scale**2)


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
    blur, line, lean, oval : bool
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
    oval: bool

    @property
    def background_terms(self) -> int:
        """Number of the background's coefficients: level, polynomial, waves, slopes, in this order."""
        return _count(self.background, self.background_waves, self.background_slopes)

    @property
    def lean_places(self) -> tuple[int, int]:
        """Where the two leans are, counted from the end of all parameters."""
        return (-4, -3) if self.oval else (-2, -1)

    @property
    def oval_places(self) -> tuple[int, int]:
        """Where the two of `oval` are, counted from the end of all parameters."""
        return -2, -1

    @property
    def groups(self) -> list[slice]:
        """Where among the surfaces' coefficients are those that a spot may not need: slopes, then all but the level."""
        found = []
        for first, (degree, highest, slopes) in (
            (0, (self.background, self.background_waves, self.background_slopes)),
            (self.background_terms, (self.plateau, self.plateau_waves, self.plateau_slopes)),
        ):
            end = first + _count(degree, highest, slopes)
            middle = end - N_ELLIPSE * slopes
            found += [slice(middle, end)] * slopes + [slice(first + 1, middle)] * (middle > first + 1)
        return sorted(found, key=lambda group: group.stop - group.start == N_ELLIPSE, reverse=True)


def _count(degree: int, highest: int, slopes: bool) -> int:
    return 1 + 2 * max(degree, highest) + N_ELLIPSE * slopes


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
    scale : float
        The plateau's height, roughly, share of full scale: what variations are large or small against.
    """

    kind: Kind
    freedom: Freedom
    widths: Widths
    offset: Array
    surface: Array
    noise: Array
    scale: float


@dataclass(frozen=True, eq=False)
class Terms:
    """What of the model does not change while it is fitted; M pixels.

    Parameters
    ----------
    u, curvature, values : (M,) array
        As in `Band`.
    stretch : (M,) array
        By how much more than on average the beam's own scale is stretched across the boundary.
    directions : (2, M) array
        Cosine and sine of twice the direction of the boundary's normal.
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
    directions: Array
    boundary: Array
    ground: Array
    top: Array
    slope: Array
    rest: Array

    def part(self, keep: Mask) -> "Terms":
        """Return the terms of these pixels (M,) alone."""
        if keep.all():
            return self
        places = np.flatnonzero(keep)
        return Terms(*(getattr(self, field.name).take(places, axis=-1) for field in fields(self)))

    def thinned(self, every: int) -> "Terms":
        """Return the terms of every so many-th pixel."""
        return Terms(*(np.ascontiguousarray(getattr(self, field.name)[..., ::every]) for field in fields(self)))


@dataclass(frozen=True, eq=False)
class Seen:
    """A model in the pixels of a band; M pixels.

    Parameters
    ----------
    value : (M,) array
    height : (M,) array
        Of the value over the background.
    plateau : (M,) array
        The plateau's height (of a ring: that of its light, times px), as it would be there.
    position : (M,) array
        Derivative by the boundary's place, px outwards.
    level, slope : (M,) array
        Of the profile; `slope` inwards, 1/px.
    smear : (M,) array
        The slope times the blur's variance across the boundary, px.
    scale : (M,) array
        The beam's own, over its mean.
    oval : (M,) array
        Share by which the blur's variance is larger across the boundary.
    across, along : (M,) array
        Derivatives of the value by the width's and by the shift's variance, 1/px^2.
    """

    value: Array
    height: Array
    plateau: Array
    position: Array
    level: Array
    slope: Array
    smear: Array
    scale: Array
    oval: Array
    across: Array
    along: Array

    def part(self, keep: Mask) -> "Seen":
        """Return what is seen in these pixels (M,) alone."""
        places = np.flatnonzero(keep)
        return Seen(*(getattr(self, field.name).take(places) for field in fields(self)))


def terms_of(
    band: Band, kind: Kind, free: Freedom, widths: Widths, dtype: type[np.floating[Any]] = np.float64, near: float = 1.0
) -> Terms:
    """Return the terms of a band for a model of these freedoms, its profile rendered with these widths.

    Parameters
    ----------
    band, kind, free, widths
    dtype : type
        Of the matrices: in single precision they are twice as fast, and far finer than the noise.
    near : float
        How many times more than what is usual the profile may be off before it is rendered.
    """
    size = band.outline.size
    c, s = band.turn
    stretch = 1.0 / np.sqrt((c * (size / band.outline.a)) ** 2 + (s * (size / band.outline.b)) ** 2)
    all_waves = waves_of(band.turn.astype(dtype), max(free.waves, free.background_waves, free.plateau_waves))
    ground, _ = _surface(band, all_waves, free.background, free.background_waves, free.background_slopes)
    top, slope = _surface(band, all_waves, free.plateau, free.plateau_waves, free.plateau_slopes)
    return Terms(
        u=band.u,
        curvature=band.curvature,
        values=band.values,
        stretch=stretch,
        directions=_doubled(band.normals.astype(dtype)),
        boundary=all_waves[: 2 * free.waves + 1],
        ground=ground,
        top=top,
        slope=slope,
        rest=_remainder(band, kind, widths, stretch, near),
    )


def _doubled(normals: NDArray[Any]) -> NDArray[Any]:
    """Return cosine and sine (2, M) of twice the direction of unit vectors (2, M)."""
    x, y = normals
    return np.stack([x * x - y * y, 2 * x * y])


def _surface(
    band: Band, all_waves: NDArray[Any], degree: int, highest: int, slopes: bool
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the terms (n, M) of a surface, and their derivatives (n, M) across the boundary, 1/px."""
    dtype, size = all_waves.dtype, band.outline.size
    wavy = all_waves[2 * degree + 1 : 2 * highest + 1]
    rising = all_waves[:N_ELLIPSE] / dtype.type(size) if slopes else all_waves[:0]
    places, normals = band.places.astype(dtype), (band.normals / size).astype(dtype)
    value = [surface(places, degree), wavy, rising * band.u.astype(dtype)]
    slope = [surface_slope(places, normals, degree), np.zeros_like(wavy), rising]
    return np.concatenate(value), np.concatenate(slope)


def _remainder(band: Band, kind: Kind, widths: Widths, stretch: Array, near: float) -> Array:
    blur, line = float(np.sqrt(widths.blur)), float(np.sqrt(widths.line))
    if is_gentle(kind, band.outline, widths.mean / near):
        return np.zeros(len(band.u))
    level, _, _ = _profile(kind, band.u, band.curvature, stretch, stretch, np.zeros(len(band.u)), widths)
    return rendered(kind, band.outline, blur, line, band.box)[band.rows, band.columns] - level


def _profile(
    kind: Kind, u: Array, curvature: Array, stretch: Array, scale: Array, oval: Array, widths: Widths
) -> tuple[Array, Array, tuple[Array, Array]]:
    """Return the profile (M,), its slope inwards, and its derivatives by the width's and by the shift's variance.

    Parameters
    ----------
    kind, u, curvature
    stretch : (M,) array
        By how much more than on average a concentric ellipse's scale is stretched across the boundary.
    scale : (M,) array
        The same for the beam's own.
    oval : (M,) array
        Share by which the blur's variance is larger across the boundary, and smaller along it.
    widths : Widths
    """
    width = widths.total(scale, oval)
    moved = curved(u, curvature, 1.0)
    x = u + moved * (widths.blur * (1 - oval))
    level, slope = profile(kind, x, width)
    widening = slope * x / width
    if kind == "ring":
        # The same light in a line that is wider by its own scale, and lower as it is blurred. Where its scale leans the
        # plateau's waves make up for it.
        peak = stretch / width
        widening = peak * (widening - level / width)
        level, slope = peak * level, peak * slope
    return level, slope, (widening / (2 * width), -slope * moved)


def see(terms: Terms, model: Model) -> Seen:
    """Return the model in the pixels of some terms."""
    dtype = terms.ground.dtype
    u = terms.u - model.offset.astype(dtype) @ terms.boundary
    turn = terms.boundary[1:3]
    scale = terms.stretch * (1 + np.array(model.widths.lean, dtype=dtype) @ turn)
    oval = np.array(model.widths.oval, dtype=dtype) @ terms.directions
    level, slope, (across, along) = _profile(model.kind, u, terms.curvature, terms.stretch, scale, oval, model.widths)
    level = level + terms.rest
    split = model.freedom.background_terms
    ground, top = model.surface[:split].astype(dtype), model.surface[split:].astype(dtype)
    plateau = top @ terms.top
    # A plateau with a slope, blurred: the product of both, and by Stein's identity blur^2 times the product of slopes.
    smear = model.widths.blur * (1 + oval) * slope
    height = plateau * level - (top @ terms.slope) * smear
    return Seen(
        value=ground @ terms.ground + height,
        height=height,
        plateau=plateau,
        position=plateau * slope,
        level=level,
        slope=slope,
        smear=smear,
        scale=scale,
        oval=oval,
        across=plateau * across,
        along=plateau * along,
    )


def by_widths(terms: Terms, model: Model, seen: Seen) -> Array:
    """Return the derivatives (n, M) by those that are free of the variances of blur and line, the leans, the ovals."""
    free, widths, rows = model.freedom, model.widths, []
    if free.blur:
        rows.append((seen.across * (1 + seen.oval) + seen.along * (1 - seen.oval))[None])
    if free.line:
        rows.append((seen.across * seen.scale**2)[None])
    if free.lean:
        rows.append(seen.across * (2 * widths.line * seen.scale * terms.stretch) * terms.boundary[1:3])
    if free.oval:
        rows.append((seen.across - seen.along) * widths.blur * terms.directions)
    return np.concatenate(rows) if rows else np.empty((0, len(seen.value)))


def design(terms: Terms, seen: Seen) -> Array:
    """Return the derivatives (n, M) by the coefficients of background and plateau."""
    dtype = terms.top.dtype
    top = terms.top * seen.level.astype(dtype) - terms.slope * seen.smear.astype(dtype)
    return np.concatenate([terms.ground, top])


def variance(model: Model, seen: Seen) -> Array:
    """Return the variance of each pixel's noise (M,)."""
    height = np.maximum(seen.height, 0.0)
    return model.noise[0] + model.noise[1] * height + model.noise[2] * height**2
