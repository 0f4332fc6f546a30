"""The spot: from an image to sub-pixel boundary points with their noise, flags and reasons."""

from planeopt.spot.files import read_image, read_points, write_points
from planeopt.spot.find import find_spot
from planeopt.spot.points import Kind, NoSpotReason, Spot, SpotFlag, SpotNotFound

__all__ = [
    "Kind",
    "NoSpotReason",
    "Spot",
    "SpotFlag",
    "SpotNotFound",
    "find_spot",
    "read_image",
    "read_points",
    "write_points",
]
