"""mrcal's cameramodel: a Python literal, `LENSMODEL_OPENCV5`.

`intrinsics` are [fx, fy, cx, cy, k1, k2, p1, p2, k3], in OpenCV's order. The pose of the camera is the identity, under
the key `extrinsics`, which all of mrcal's releases read; the newest call it `rt_cam_ref`. `lensmodel` comes before
`intrinsics` because mrcal's reader in C asks for that order: mrcal's documentation, "Camera model file formats", and
cameramodel-parser.re.
"""

from planeopt.formats.digits import comment, listed
from planeopt.rig import Camera


def mrcal_text(camera: Camera, name: str, remarks: tuple[str, ...] = ()) -> str:
    """Return the text of a cameramodel file.

    Parameters
    ----------
    camera : Camera
    name : str
        Of the camera; it stands in the comment.
    remarks : tuple of str
        Sentences for the comment at its head.
    """
    lines = [
        *comment((f"camera: {name}", *remarks)),
        "{",
        "    'lensmodel': 'LENSMODEL_OPENCV5',",
        "    # fx, fy, cx, cy, k1, k2, p1, p2, k3",
        f"    'intrinsics': {listed((camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion))},",
        "    # rt_cam_ref: the camera is its own reference",
        f"    'extrinsics': {listed([0.0] * 6)},",
        f"    'imagersize': [{camera.image_size[0]}, {camera.image_size[1]}],",
        "}",
    ]
    return "\n".join(lines) + "\n"
