"""The two lines that bound the beam's image: every spot that the beam can draw lies between them and touches both.

The planes through the camera's centre that touch the beam meet the laser-parallel image plane in two lines through the
beam's vanishing point (the origin there). They do not depend on the plane that is lit: they test what a spot may be.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.rig.model import Rig

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Where in the image a rig's spot can be.

    Parameters
    ----------
    rig : Rig
    inward : (2, 2) array
        Unit normals of the two lines on the laser-parallel image plane, towards the beam, one a row.
    towards : (2,) array
        Unit vector from the vanishing point to the near end of the beam.
    """

    rig: Rig
    inward: Array
    towards: Array

    def distances(self, px: ArrayLike) -> tuple[Array, Array]:
        """Return how far pixels lie inside the two lines, (N, 2), and how far before the vanishing point, (N,), px.

        Negative outside; to first order, in raw pixels.

        Parameters
        ----------
        px : array_like, shape (N, 2)
            Raw (distorted) pixels.

        Raises
        ------
        InputError
            If the distortion cannot be inverted at a pixel, or its ray does not point along the beam.
        """
        points, jacobian = self.rig.to_laser_plane(px)
        scale = 1 / np.sqrt(np.abs(np.linalg.det(jacobian)))
        return points @ self.inward.T * scale[:, None], points @ self.towards * scale


def silhouette(rig: Rig) -> Silhouette | None:
    """Return the lines that bound the beam's image; ``None`` where the camera is in the beam and there are none."""
    e = np.array(rig.laser_offset)
    ratio = rig.require_beam().radius / max(float(np.hypot(*e)), 1e-300)
    if ratio >= 1:
        return None
    along = e / np.hypot(*e)
    across = np.array([-along[1], along[0]])
    # A tangent from the origin to a circle: its angle to the centre has the sine r/|e|.
    c = np.sqrt(1 - ratio**2)
    return Silhouette(rig, np.stack([ratio * along + c * across, ratio * along - c * across]), along)
