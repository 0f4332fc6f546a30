"""Discs and rings with exactly known boundaries, for tests only: supersampled, blurred, averaged over the pixels."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """An elliptic spot in an image of `size` (width, height); grey values 0 to 255, lengths in px.

    `blur` is the standard deviation of the optics alone: the pixel's own area comes on top of it. `line` is the
    standard deviation of a ring's own profile, a function of the radius in units of the ellipse's, as a beam's is.
    """

    centre: tuple[float, float] = (60.3, 55.8)
    semi_axes: tuple[float, float] = (30.0, 24.0)
    angle: float = 0.4
    blur: float = 1.2
    background: float = 30.0
    height: float = 180.0
    size: tuple[int, int] = (120, 110)
    kind: str = "disc"
    line: float = 0.8

    def clean(self, factor: int = 8) -> Array:
        """Return the image (H, W) without noise."""
        width, height = self.size
        x = (np.arange(width * factor) + 0.5) / factor - 0.5 - self.centre[0]
        y = ((np.arange(height * factor) + 0.5) / factor - 0.5 - self.centre[1])[:, None]
        c, s = np.cos(self.angle), np.sin(self.angle)
        a, b = self.semi_axes
        u, v = (c * x + s * y) / a, (c * y - s * x) / b
        rho = np.hypot(u, v)
        # First-order distance: near the boundary, where it matters, it is exact to the square of 1/factor.
        slope = np.hypot(u / a, v / b) / np.maximum(rho, 1e-9)
        distance = (rho - 1) / slope
        if self.kind == "disc":
            light = np.clip(0.5 - distance * factor, 0, 1)
        else:
            light = np.exp(-(((rho - 1) * np.sqrt(a * b) / self.line) ** 2) / 2)
        if self.blur > 0:
            light = cv2.GaussianBlur(light, (0, 0), self.blur * factor, borderType=cv2.BORDER_REPLICATE)
        pixels = light.reshape(height, factor, width, factor).mean(axis=(1, 3))
        return self.background + self.height * np.asarray(pixels, dtype=np.float64)

    def image(self, noise: float = 0.0, seed: int = 0) -> NDArray[np.uint8]:
        """Return the image in 8 bits with white noise of this standard deviation."""
        return noisy(self.clean(), noise, seed)

    def offsets(self, points: Array) -> tuple[Array, Array]:
        """Return distances (N,) of points from the true boundary, outwards, and their angles (N,) round the ellipse."""
        d = points - np.array(self.centre)
        c, s = np.cos(self.angle), np.sin(self.angle)
        a, b = self.semi_axes
        u, v = (d @ [c, s]) / a, (d @ [-s, c]) / b
        # (rho^2 - 1) / |grad rho^2|: its error is the square of the distance over the radius, 1e-4 px here.
        return (u**2 + v**2 - 1) / (2 * np.hypot(u / a, v / b)), np.arctan2(v, u)


def noisy(clean: Array, noise: float, seed: int) -> NDArray[np.uint8]:
    """Return the image in 8 bits with white noise of this standard deviation."""
    noise_values = np.random.default_rng(seed).normal(0, noise, clean.shape) if noise else 0.0
    return np.clip(np.rint(clean + noise_values), 0, 255).astype(np.uint8)


def low_harmonics(offsets: Array, sigma: Array, angles: Array) -> tuple[Array, Array]:
    """Return the weighted fit (5,) of the changes that an ellipse can make, and its covariance (5, 5)."""
    design = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles), np.cos(2 * angles), np.sin(2 * angles)], 1)
    weighted = design / sigma[:, None]
    covariance: Array = np.asarray(np.linalg.inv(weighted.T @ weighted), dtype=np.float64)
    return covariance @ (weighted.T @ (offsets / sigma)), covariance
