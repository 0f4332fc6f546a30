"""kalibr's camchain: one camera, `cam0`, `pinhole` with `radtan`.

`intrinsics` are [fu, fv, pu, pv], `distortion_coeffs` [k1, k2, p1, p2], of which kalibr calls the last two r1 and r2:
kalibr's wiki, "Yaml formats" and "Supported models". Its reader, kalibr_common/ConfigReader.py, wants floats for all of
them, a principal point that is not negative, whole numbers for `resolution` and a text for `rostopic`.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.formats.digits import comment, listed
from planeopt.rig import Camera

# Nodes along each side of the image at which a change of the model is looked at, the corners among them.
_NODES = 33


def kalibr_text(camera: Camera, name: str, remarks: tuple[str, ...] = ()) -> str:
    """Return the text of a camchain file.

    Parameters
    ----------
    camera : Camera
    name : str
        Of the camera; its topic is `/NAME/image_raw`.
    remarks : tuple of str
        Sentences for the comment at its head.

    Raises
    ------
    InputError
        If the camera has a k3, for which kalibr's `radtan` has no place; says what would be lost. If the principal
        point is negative, which kalibr refuses.
    """
    k1, k2, p1, p2, k3 = camera.distortion
    if k3 != 0:
        raise InputError(
            f"kalibr's radtan has k1, k2, p1 and p2 only, but this camera has k3 = {k3:g}, which moves pixels by up to "
            f"{largest_move(camera, replace(camera, distortion=(k1, k2, p1, p2, 0.0))):.3g} px; --approximate fits the "
            f"other four anew in its place, which is right to {largest_move(camera, without_k3(camera)):.3g} px"
        )
    if camera.cx < 0 or camera.cy < 0:
        raise InputError(
            f"kalibr refuses a principal point that is negative, as ({camera.cx:g}, {camera.cy:g}) px is: take another "
            "format"
        )
    lines = [
        *comment(remarks),
        "cam0:",
        "  camera_model: pinhole",
        f"  intrinsics: {listed((camera.fx, camera.fy, camera.cx, camera.cy))}",
        "  distortion_model: radtan",
        f"  distortion_coeffs: {listed((k1, k2, p1, p2))}",
        f"  resolution: [{camera.image_size[0]}, {camera.image_size[1]}]",
        f'  rostopic: "/{name.lstrip("/")}/image_raw"',
    ]
    return "\n".join(lines) + "\n"


def without_k3(camera: Camera) -> Camera:
    """Return the camera without k3 whose image is nearest, with k1, k2, p1 and p2 fitted over the whole image.

    Least squares in pixels over the image, linear because the distortion is linear in its coefficients; focal length
    and principal point stay as they are.

    Raises
    ------
    InputError
        If the distortion cannot be inverted everywhere on the image.
    """
    pixels, normalised = _grid(camera)
    x, y = normalised.T
    r2 = x * x + y * y
    along_x = camera.fx * np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x], axis=1)
    along_y = camera.fy * np.stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y], axis=1)
    plain = normalised * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    columns = np.concatenate([along_x, along_y])
    # Columns of one length: what small numbers are to large ones is not what counts.
    norms = np.linalg.norm(columns, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    fitted, *_ = np.linalg.lstsq(columns / scale, (pixels - plain).T.ravel(), rcond=None)
    k1, k2, p1, p2 = (fitted / scale).tolist()
    return replace(camera, distortion=(k1, k2, p1, p2, 0.0))


def largest_move(camera: Camera, other: Camera) -> float:
    """Return how far apart two cameras see the same rays, at most, over the image of the first, px.

    Raises
    ------
    InputError
        If the first's distortion cannot be inverted everywhere on the image.
    """
    pixels, normalised = _grid(camera)
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.max(np.hypot(*(other.project(normalised) - pixels).T)))


def _grid(camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return pixels (N, 2) all over the image, and their rays in normalised coordinates (N, 2)."""
    width, height = camera.image_size
    u, v = np.meshgrid(np.linspace(0, width - 1, _NODES), np.linspace(0, height - 1, _NODES))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    normalised, _ = camera.normalise(pixels)
    return pixels, normalised
