"""Image in, spot out."""

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.conic import arc_fraction
from planeopt.errors import InputError
from planeopt.rig import Camera, Rig, SpotDefinition
from planeopt.spot.boundary import Boundary, Straighten, measure_boundary
from planeopt.spot.candidates import find_candidate
from planeopt.spot.grey import Grey, to_grey
from planeopt.spot.points import Kind, Spot, SpotFlag
from planeopt.spot.pyramid import noise_of

_log = logging.getLogger(__name__)

_CLIPPED = 0.01  # of the spot's pixels
_FAINT = 10.0  # edge over noise
_WHOLE = 0.9  # of the boundary
_MANY_OUTLIERS = 0.05  # of what is there of it
_STRONG_CURVATURE = 0.3  # curvature times blur
_EXCESS = 3.0  # scatter over what the noise explains
_LEVEL_DEPENDENT = 0.1  # px between the two halves of the edge
_BENT = 0.6  # of the exponent: a gamma of 1.5 shows; lenses that do not blur as a Gaussian does seem to be 0.4
_AMBIGUITY = 0.05  # px


def find_spot(
    image: ArrayLike,
    rig: Rig | None = None,
    *,
    kind: Kind | None = None,
    region: Sequence[float] | None = None,
    previous: Spot | ArrayLike | None = None,
    dark: ArrayLike | None = None,
    camera_blur: float | None = None,
    level: float | None = None,
    channel: str | None = None,
    gamma: float | None = None,
    source: str | None = None,
) -> Spot:
    """Find the laser spot in an image and measure its boundary to a small fraction of a pixel.

    A disc or ring on a darker surface; up to a third of it may be hidden or lie off the image. A model of the blurred
    edge (ridge), with a plateau and a background that vary smoothly, is fitted to all pixels of the band round it; each
    piece of the boundary, about a pixel long, then says by itself where it is (``docs/measurement.md``).

    Parameters
    ----------
    image : (H, W), (H, W, 3) or (H, W, 4) array
        Unsigned integers or floats; colour as OpenCV orders it: blue, green, red.
    rig : Rig, optional
        Its ``spot`` says what the boundary is (kind, level, channel, gamma), its camera how large the image must be,
        and its beam where in the image the spot can lie.
    kind : {"disc", "ring"}, optional
        Overrides the rig's. If nobody says, it is told from the image.
    region : sequence of four numbers, optional
        ``(x0, y0, x1, y1)``, px: the part of the image where the spot's centre is.
    previous : Spot or array_like, optional
        The spot in the frame before, its centre ``(x, y)``, or points of its boundary (N, 2), px. It is looked for
        there first, which is faster, and elsewhere if it is not there.
    dark : array_like, optional
        The same view with the laser off, of the same shape and type; it is subtracted, in linear light.
    camera_blur : float, optional
        Standard deviation of what optics and pixels blur, px, if known. It matters for small spots with a boundary that
        is soft by itself, rings above all (`SpotFlag.OWN_WIDTH`).
    level, channel, gamma : optional
        As in `planeopt.rig.SpotDefinition`, where there is no rig that says so; they must not contradict the rig's.
    source : str, optional
        Name of the file, for the record.

    Returns
    -------
    Spot
        Points in raw pixels in order round the boundary, with `sigma`.

    Raises
    ------
    SpotNotFound
        If there is no spot, no single one, or none that can be measured; carries the reason.
    InputError
        If an array is not an image, not of the rig's size, the region does not lie in it, or the rig defines its
        spot otherwise than asked for.
    """
    definition = _definition(rig, {"level": level, "channel": channel, "gamma": gamma})
    if camera_blur is not None and not 0 < camera_blur < np.inf:
        raise InputError(f"camera_blur must be a positive number of pixels, not {camera_blur!r}")
    said = kind if kind is not None else _kind(rig)
    if said not in (None, "disc", "ring"):
        raise InputError(f'kind must be "disc" or "ring", not {said!r}')
    grey = to_grey(image, definition.channel, definition.gamma, dark)
    if rig is not None:
        _check_size(grey.shape, rig, source)
    noise = noise_of(grey)
    candidate = find_candidate(grey, noise, said, rig=rig, region=region, previous=previous)
    boundary = measure_boundary(
        grey,
        candidate,
        noise=noise,
        level=definition.level,
        camera_blur=camera_blur,
        straighten=None if rig is None else _straighten(rig.camera),
    )
    _log.debug(
        "%s: %d points, width %.2f px, scatter %.2f of the noise's, inflation %.2f",
        source or "image",
        len(boundary.points),
        boundary.width,
        boundary.excess,
        boundary.inflation,
    )
    saturation = _saturation(grey, boundary)
    return Spot(
        points=boundary.points,
        sigma=boundary.sigma,
        kind=candidate.kind,
        arc_fraction=float(arc_fraction(boundary.outline.conic, boundary.points)),
        contrast=boundary.height,
        blur=boundary.width,
        saturation=saturation,
        noise=boundary.noise,
        rejected=boundary.rejected,
        flags=_flags(boundary, noise, saturation, said is None and candidate.kind == "ring"),
        source=source,
    )


def _definition(rig: Rig | None, asked: dict[str, Any]) -> SpotDefinition:
    asked = {name: value for name, value in asked.items() if value is not None}
    if rig is None or rig.spot is None:
        return SpotDefinition(**asked)
    for name, value in asked.items():
        own = getattr(rig.spot, name)
        if value != own:
            raise InputError(
                f"{name} {value} was asked for, but the rig's radius was calibrated with {own}: leave it out"
            )
    return rig.spot


def _kind(rig: Rig | None) -> Kind | None:
    if rig is None or rig.spot is None:
        return None
    return "ring" if rig.spot.kind == "ring" else "disc"


def _straighten(camera: Camera) -> Straighten:
    def straight(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        normalised, jacobian = camera.normalise(points)
        focal = np.sqrt(camera.fx * camera.fy)
        return focal * normalised, focal * np.sqrt(np.abs(np.linalg.det(jacobian)))

    return straight


def _check_size(shape: tuple[int, ...], rig: Rig, source: str | None) -> None:
    width, height = rig.camera.image_size
    if shape != (height, width):
        raise InputError(
            f"{source or 'image'}: {shape[1]} x {shape[0]} px, but the rig was calibrated with images of "
            f"{width} x {height} px; use images as the camera gave them, neither cropped nor resized"
        )


def _saturation(grey: Grey, boundary: Boundary) -> float | None:
    """Return the share of clipped pixels where the spot is bright: above half its height."""
    x, y = boundary.outline.x, boundary.outline.y
    wide, high = boundary.outline.grown(1.1).extent
    height, width = grey.shape
    box = (max(int(x - wide), 0), max(int(y - high), 0), min(int(x + wide) + 2, width), min(int(y + high) + 2, height))
    clipped = grey.crop_clipped(box)
    if clipped is None:
        return None
    # The fitted height is that of the light: more than the camera shows of a clipped plateau.
    height = min(boundary.height, 1.0 - boundary.background)
    bright = grey.crop(box) > boundary.background + height / 2
    return float((clipped & bright).sum() / max(int(bright.sum()), 1))


def _flags(boundary: Boundary, noise: float, saturation: float | None, ring_assumed: bool) -> tuple[SpotFlag, ...]:
    found = {
        SpotFlag.RING_ASSUMED: ring_assumed,
        SpotFlag.SATURATED: saturation is not None and saturation > _CLIPPED,
        SpotFlag.LOW_CONTRAST: boundary.height < _FAINT * noise,
        SpotFlag.PARTIAL_ARC: boundary.share < _WHOLE,
        SpotFlag.MANY_OUTLIERS: boundary.outliers > _MANY_OUTLIERS,
        SpotFlag.STRONG_CURVATURE: boundary.curvature > _STRONG_CURVATURE,
        SpotFlag.OWN_WIDTH: boundary.ambiguity > _AMBIGUITY,
        SpotFlag.LEVEL_DEPENDENT: boundary.level_dependence > _LEVEL_DEPENDENT,
        SpotFlag.RESPONSE: abs(boundary.response) > _BENT,
        SpotFlag.NOT_AN_ELLIPSE: boundary.excess > _EXCESS,
    }
    return tuple(flag for flag, applies in found.items() if applies)
