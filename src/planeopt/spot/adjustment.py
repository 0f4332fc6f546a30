"""The model of a blurred edge or ridge, fitted to the pixels of the band round a spot by weighted least squares.

Gauss-Newton over all parameters at once. Clipped pixels tell nothing and are not among those fitted to.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray
from scipy.stats import chi2

from planeopt.spot.model import N_ELLIPSE, Model, Seen, Terms, Widths, by_widths, design, see, variance
from planeopt.spot.robust import MEDIAN_OF_NORMAL, deviation

Array = NDArray[np.float64]

_LEAST_VARIANCE = 0.04  # px^2: a pixel alone blurs more
_SHARE, _SHARE_SIGMA = 0.5, 0.3  # of a ring's width that is blur, where the picture does not tell: anything from 0 to 1
_CHANCE = 0.02  # with which a variation that is not there is taken for one
_FAR = 2.5  # usual residuals, where a pixel counts half
_LEAN_SIGMA, _MOST_LEAN = 0.3, 0.6
_OVAL_SIGMA, _MOST_OVAL = 0.5, 0.9
_UNEVEN = 0.5  # of the plateau's height: a variation of background or plateau is hardly larger
_START = 0.01  # of its own, by which each coefficient is held at nought
_CLASSES = 12  # of height, in which the noise is looked at
_START_PIXELS = 4000  # of more, so many are fitted to before all are
# Of the width: after a step of Gauss-Newton no longer than this, what is left is of the order of its square, and the
# segments find that by themselves; a reweighted fit comes near its end more slowly.
_SETTLED, _NEARLY = 0.05, 3e-3
_EXCHANGED = 0.2  # blur for line at the same width: it hardly changes the profile


def noise_law(seen: Seen, residual: Array) -> Array:
    """Return the variance of a pixel's noise as a polynomial (3,) of its height over the background, none negative.

    By non-negative least squares on the median squared residual in classes of height, whatever a few segments see that
    is not the spot; a class counts by how well its noise is known, which is in proportion to the variance itself. Read
    noise, shot noise and speckle are its three terms.
    """
    classes = np.array_split(np.argsort(seen.height), _CLASSES)
    height = np.maximum(np.array([seen.height[members].mean() for members in classes]), 0.0)
    mean = np.array([np.median(residual[members] ** 2) for members in classes]) / MEDIAN_OF_NORMAL**2
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
        n, places = N_ELLIPSE, self._shared
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
        fit, first = self, len(self.model.offset)
        for group in self.model.freedom.groups:
            fit = fit._without(np.arange(first + group.start, first + group.stop), fit.model.surface[group])
        if self.model.freedom.oval:
            places = len(self.information) + np.array(self.model.freedom.oval_places)
            fit = fit._without(places, np.array(fit.model.widths.oval))
        return fit

    def _without(self, gone: NDArray[np.intp], value: Array) -> "Fitted":
        stays = np.diag(self.information) > 0
        stays[gone] = False
        kept = np.flatnonzero(stays)
        rest, mixed = self.information[np.ix_(kept, kept)], self.information[np.ix_(kept, gone)]
        through = solve(rest, mixed)
        left = self.information[np.ix_(gone, gone)] - mixed.T @ through
        if float(value @ left @ value) > _by_chance(len(gone)):
            return self
        change = np.zeros(len(self.information))
        change[kept], change[gone] = through @ value, -value
        # An information of nought stands for what has gone.
        information = self.information.copy()
        information[gone] = information[:, gone] = 0.0
        return Fitted(_moved(self.model, change)[0], information)

    @property
    def _shared(self) -> NDArray[np.intp]:
        """Places of what all points share, among all parameters."""
        first = len(self.model.offset)
        return first + np.flatnonzero(np.diag(self.information)[first:] > 0)

    @property
    def _has_oval(self) -> bool:
        return bool(self.information[-1, -1] > 0)

    @property
    def blur_sigma(self) -> float:
        """Standard deviation of the blur's variance, px^2; 0 where it is given."""
        if not self.model.freedom.blur:
            return 0.0
        places = np.concatenate([np.arange(N_ELLIPSE), self._shared])
        free = self.model.freedom
        place = len(places) - int(free.line) - 2 * int(free.lean) - 2 * int(free.oval and self._has_oval) - 1
        return float(np.sqrt(np.diag(np.linalg.inv(self.information[np.ix_(places, places)]))[place]))


@cache
def _by_chance(freedoms: int) -> float:
    return float(chi2.isf(_CHANCE, freedoms))


def solve(matrix: Array, right: Array) -> Array:
    """Return the solution of normal equations; what they do not determine stays nought."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-12 * float(np.trace(matrix)) + 1e-300))
    tamed = matrix * scale * scale[:, None] + 1e-12 * np.eye(len(scale))
    return (scale * np.linalg.solve(tamed, (scale * right.T).T).T).T


def fit_model(terms: Terms, model: Model, *, steps: int, robust: bool) -> Fitted:
    """Fit a model to pixels, from a start whose `surface` does not matter.

    Parameters
    ----------
    terms : Terms
        Of the pixels that count.
    model : Model
        Start: its widths, offset and noise.
    steps : int
        Of Gauss-Newton, at most.
    robust : bool
        Whether pixels count the less the further they are off (the weights of a Cauchy distribution): for a start, of
        whose pixels some may see something else.
    """
    every = len(terms.u) // _START_PIXELS
    some = terms.thinned(every) if every > 1 else terms
    model = replace(model, surface=_level_surfaces(some, model))
    if every > 1:
        model = _gauss_newton(some, model, steps, robust).model
    return _gauss_newton(terms, model, steps, robust)


def _level_surfaces(terms: Terms, model: Model) -> Array:
    """Return the coefficients of background and plateau that fit best, where all else is as the model has it."""
    by_surface = design(terms, see(terms, replace(model, surface=np.zeros(len(terms.ground) + len(terms.top)))))
    square = (by_surface @ by_surface.T).astype(np.float64)
    held = np.ones(len(square), dtype=np.bool_)
    held[[0, model.freedom.background_terms]] = False
    square[held, held] *= 1 + _START
    return solve(square, by_surface @ terms.values.astype(by_surface.dtype))


def _gauss_newton(terms: Terms, model: Model, steps: int, robust: bool) -> Fitted:
    information = np.eye(1)
    for _ in range(steps):
        information, right = _normal_equations(terms, model, robust=robust)
        model, size = _moved(model, solve(information, right))
        if size < (_NEARLY if robust else _SETTLED):
            break
    return Fitted(model, information)


def whitened(terms: Terms, model: Model, seen: Seen) -> tuple[Array, Array]:
    """Return the derivatives (n, M) of the pixels by all free parameters, and the residuals (M,), over their noise."""
    root, dtype = 1 / np.sqrt(variance(model, seen)), terms.ground.dtype
    rows = [seen.position.astype(dtype) * terms.boundary, design(terms, seen), by_widths(terms, model, seen)]
    jacobian = np.concatenate(rows, dtype=dtype)
    jacobian *= root.astype(dtype)
    return jacobian, (terms.values - seen.value) * root


def _normal_equations(terms: Terms, model: Model, *, robust: bool) -> tuple[Array, Array]:
    free = model.freedom
    jacobian, residual = whitened(terms, model, see(terms, model))
    if robust:
        usual = deviation(residual)
        weight = 1 / np.hypot(1.0, residual / max(_FAR * usual, 1e-12))
        jacobian, residual = jacobian * weight.astype(jacobian.dtype), residual * weight
    information = (jacobian @ jacobian.T).astype(np.float64)
    right = (jacobian @ residual.astype(jacobian.dtype)).astype(np.float64)
    if free.blur and free.line:
        total = model.widths.blur + model.widths.line
        row, first = np.zeros(len(right)), len(model.offset) + len(model.surface)
        row[first : first + 2] = np.array([1 - _SHARE, -_SHARE]) / (_SHARE_SIGMA * total)
        information += np.outer(row, row)
        right -= row * (row[first] * model.widths.blur + row[first + 1] * model.widths.line)
    # Where the boundary is hidden, nothing else keeps the surfaces from running away.
    first = len(model.offset)
    varying = np.concatenate([np.arange(first + group.start, first + group.stop) for group in free.groups] or [[]])
    varying = varying.astype(np.intp)
    information[varying, varying] += 1 / (_UNEVEN * model.scale) ** 2
    right[varying] -= model.surface[varying - first] / (_UNEVEN * model.scale) ** 2
    for there, value, sigma, places in (
        (free.lean, model.widths.lean, _LEAN_SIGMA, free.lean_places),
        (free.oval, model.widths.oval, _OVAL_SIGMA, free.oval_places),
    ):
        if there:
            # Neither is stronger than this where the spot can be measured at all; without a line nothing tells of lean.
            ends = len(right) + np.array(places)
            information[ends, ends] += 1 / sigma**2
            right[ends] -= np.array(value) / sigma**2
    return information, right


def _within(pair: tuple[float, float], change: tuple[float, float], most: float) -> tuple[float, float]:
    """Return a pair changed, but no longer than it may be."""
    x, y = pair[0] + change[0], pair[1] + change[1]
    shorter = min(1.0, most / max(float(np.hypot(x, y)), 1e-12))
    return float(x) * shorter, float(y) * shorter


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
        lean = _within(lean, (rates.pop(0), rates.pop(0)), _MOST_LEAN)
    oval = _within(widths.oval, (rates.pop(0), rates.pop(0)), _MOST_OVAL) if model.freedom.oval else widths.oval
    moved = replace(
        model,
        widths=Widths(blur, line, lean, oval),
        offset=model.offset + damping * change[:n],
        surface=model.surface + change[n:m],
    )
    wider, exchanged = blur + line - total, _EXCHANGED * (line - widths.line)
    leaning = max(abs(lean[0] - widths.lean[0]), abs(lean[1] - widths.lean[1]))
    return moved, max(size, abs(wider) / total, abs(exchanged) / total, leaning)
