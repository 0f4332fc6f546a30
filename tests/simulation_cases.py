"""Scenes for the simulator's tests, and images of them computed by other means than the simulator's."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from planeopt.plane import SpotPose
from planeopt.rig import Beam, Camera, Rig
from planeopt.simulation import BeamProfile, Noise, Optics, Scene, Surface

Array = NDArray[np.float64]

DISTORTION = (-0.16, 0.10, 0.0003, 0.0004, 0.02)
SLANTED = (0.0035, -0.005, math.sqrt(1 - 0.0035**2 - 0.005**2))
SILENT = Noise(full_well_electrons=0, read=0)


def spot_scene(
    radius_px: float = 30.0,
    tilt_deg: float = 30.0,
    *,
    offset: tuple[float, float] = (14.0, 9.0),
    distortion: tuple[float, float, float, float, float] = DISTORTION,
    direction: tuple[float, float, float] = SLANTED,
    size: tuple[int, int] = (960, 720),
    blur: float = 0.9,
    beam: BeamProfile | None = None,
) -> Scene:
    """A scene without noise on black, its spot about this large and in the image's middle."""
    z, f = 240.0, 2200.0
    across = radius_px * z / f
    middle = np.array([size[0] / 2 + 3.3, size[1] / 2 - 2.7])
    # The principal point is put where it brings the spot to the middle.
    axis = np.array(offset) + z * np.array(direction[:2]) / direction[2]
    cx, cy = (middle - f * axis / (z * direction[2])).tolist()
    rig = Rig(Camera(size, f, f - 5, cx, cy, distortion), Beam(across, offset, direction))
    return Scene.of(
        rig,
        SpotPose.from_slopes(z, *_slopes(tilt_deg), across),
        beam=BeamProfile(height=1.0) if beam is None else beam,
        surface=Surface(background=0.0),
        optics=Optics(blur_px=blur),
        noise=SILENT,
    )


def _slopes(tilt_deg: float) -> tuple[float, float]:
    tangent = math.tan(math.radians(tilt_deg))
    return -tangent * math.sin(0.7), tangent * math.cos(0.7)


def outline(scene: Scene, count: int = 4096) -> Array:
    """Raw pixels (count, 2) of the boundary, through the laser-parallel image plane."""
    rig, pose = scene.rig, scene.pose
    theta = np.arange(count) * (math.tau / count)
    (e_x, e_y), (p, q), r = rig.laser_offset, pose.slopes, rig.require_beam().radius
    dx, dy = r * np.cos(theta), r * np.sin(theta)
    z = pose.z_L + rig.axial_shift + p * dx + q * dy
    return rig.from_laser_plane(rig.focal_length * np.stack([e_x + dx, e_y + dy], axis=1) / z[:, None])


def rho(scene: Scene, px: Array) -> tuple[Array, Array]:
    """Places (..., 2) of pixels (..., 2) in the cross-section in radii, and their distance from the axis."""
    rig, pose = scene.rig, scene.pose
    (e_x, e_y), (p, q), r = rig.laser_offset, pose.slopes, rig.require_beam().radius
    image = rig.to_laser_plane(px.reshape(-1, 2))[0].reshape(px.shape) / rig.focal_length
    depth = (pose.z_L + rig.axial_shift - p * e_x - q * e_y) / (1 - image @ np.array([p, q]))
    xi = (image * depth[..., None] - [e_x, e_y]) / r
    return xi, np.hypot(xi[..., 0], xi[..., 1])


def kernel(x: Array, blur: float) -> Array:
    """The lens's Gaussian averaged over a pixel, at distances x."""
    return ndtr((x + 0.5) / blur) - ndtr((x - 0.5) / blur)


def sharp_disc(scene: Scene) -> Array:
    """The image (H, W) of a sharp disc, to rounding: the integral over its area as one along its outline.

    By Gauss's theorem the integral of h(x) h(y) over an area is that of K(x) h(y) dy round it, K the antiderivative of
    h; on a smooth closed curve the trapezoidal rule is exact but for terms that vanish exponentially.
    """
    points = outline(scene)
    count, blur = len(points), scene.optics.blur_px
    width, height = scene.rig.camera.image_size
    order = np.fft.fftfreq(count, 1 / count)
    step = np.fft.ifft(1j * order * np.fft.fft(points[:, 1])).real * (math.tau / count)
    step *= np.sign(np.sum(points[:, 0] * step))

    def ramp(z: Array) -> Array:
        return z * ndtr(z) + np.exp(-z * z / 2) / math.sqrt(math.tau)

    x = points[:, 0] - np.arange(width)[:, None]
    along_x = blur * (ramp((x + 0.5) / blur) - ramp((x - 0.5) / blur))
    along_y = kernel(points[:, 1] - np.arange(height)[:, None], blur) * step
    return along_y @ along_x.T


def smooth_light(scene: Scene, irradiance, pixels: Array, per_px: int = 16) -> Array:
    """The light (N,) at some pixels (N, 2): a plain sum over many samples a pixel of a smooth irradiance(xi, rho)."""
    blur = scene.optics.blur_px
    reach = math.ceil(7 * blur + 1)
    t = (np.arange(2 * reach * per_px) + 0.5) / per_px - reach
    weight = kernel(t, blur) / per_px
    dx, dy = np.meshgrid(t, t)
    samples = pixels[:, None, None, :] + np.stack([dx, dy], axis=-1)
    return np.einsum("nij,i,j->n", irradiance(*rho(scene, samples)), weight, weight)


def in_px(error: Array, scene: Scene) -> Array:
    """An error of the light at the edge of a disc of height 1 as a shift of that edge, px."""
    return error * math.sqrt(math.tau * (scene.optics.blur_px**2 + 1 / 12))
