"""kalibr's camchain: one camera, `cam0`, `pinhole` with `radtan`.

`intrinsics` are [fu, fv, pu, pv], `distortion_coeffs` [k1, k2, p1, p2], of which kalibr calls the last two r1 and r2:
kalibr's wiki, "Yaml formats" and "Supported models". Its reader, kalibr_common/ConfigReader.py, wants floats for all of
them, a principal point that is not negative, whole numbers for `resolution` and a text for `rostopic`.
"""

import numpy as np

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
            f"kalibr's radtan has k1, k2, p1 and p2 only, but this camera has k3 = {k3:g}: {_loss(camera)}. "
            "Calibrate it with the tangential model, which leaves k3 out, or take another format"
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


def _loss(camera: Camera) -> str:
    """Say how far the image would move without k3."""
    width, height = camera.image_size
    u, v = np.meshgrid(np.linspace(0, width - 1, _NODES), np.linspace(0, height - 1, _NODES))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    k1, k2, p1, p2, _ = camera.distortion
    without = Camera(camera.image_size, camera.fx, camera.fy, camera.cx, camera.cy, (k1, k2, p1, p2, 0.0))
    try:
        normalised, _ = camera.normalise(pixels)
    except InputError:
        return "leaving it out would make it another camera"
    with np.errstate(over="ignore", invalid="ignore"):
        moved = np.hypot(*(without.project(normalised) - pixels).T)
    worst = int(np.argmax(moved))
    return f"without it pixels move by up to {moved[worst]:.3g} px, at ({pixels[worst, 0]:.0f}, {pixels[worst, 1]:.0f})"
