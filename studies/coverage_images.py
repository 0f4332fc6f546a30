"""Simulated images of planes of the prior, through the whole chain: find the spot, solve, sample."""

from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.executors import ordered_map
from planeopt.posterior import Prior
from planeopt.rig import Beam, Camera, Rig, SpotDefinition
from planeopt.simulation import render
from planeopt.spot import SpotNotFound, find_spot
from planeopt.spot.points import Kind
from studies.coverage_checks import Checks, check
from studies.coverage_draws import draw_covariance, draw_truth, lean
from studies.coverage_points import sample
from studies.draws import Look, Range, light
from studies.image_poses import kind_of

PRIOR = Prior(depth_radii=(20.0, 60.0))
"""Depths at which the spot fits into the image and is not too small for it."""

IMAGE_SIZE = (960, 720)
LOOK = Look(Range(40, 220), Range(1, 3))


@dataclass(frozen=True, kw_only=True)
class ImageRow(Checks):
    """One image.

    Attributes
    ----------
    seed : int
    kind : str
    covariance : str
        As in `SetRow`.
    outcome : str
        "measured", or why not: refusals depend on the image alone, and leave the posterior's claims for the others.
    """

    seed: int
    kind: str
    covariance: str
    outcome: str


def run_images(seeds: Iterable[int], executor: Executor | None) -> list[ImageRow]:
    """Render, find, solve and sample an image for each seed."""
    return list(ordered_map(measure_image, seeds, executor))


def measure_image(seed: int) -> ImageRow:
    """Render an image of a plane of the prior and measure it with the given rig; every fourth rig has a covariance."""
    rng = np.random.default_rng([75, seed])
    kind = kind_of(seed)
    rig = draw_camera(rng, kind, covariance=seed % 4 == 1)
    truth = draw_truth(rig, PRIOR, rng)
    lit = light(truth.rig, truth.pose, kind, LOOK, rng)
    outcome, solution, posterior = "measured", None, None
    try:
        spot = find_spot(render(lit.scene).image, rig, camera_blur=lit.known_blur)
        solution, posterior = solve(spot, rig), sample(spot, rig, PRIOR, seed)
    except SpotNotFound as refusal:
        outcome = refusal.reason.name.lower()
    except InputError as refusal:
        outcome = " ".join(str(refusal).split())
    checks = check(solution, posterior, truth.quantities, seed)
    covariance = "none" if rig.covariance is None else "given"
    return ImageRow(**vars(checks), seed=seed, kind=kind, covariance=covariance, outcome=outcome)


def draw_camera(rng: np.random.Generator, kind: Kind, *, covariance: bool) -> Rig:
    """Return a random rig whose image holds the spots of most planes of `PRIOR`.

    The focal length is 1400 to 2200 px, the beam's radius 2 to 10 mm, its offset 2 to 4 radii, its direction within 2
    degrees of the optical axis; the image lies about where the beam is at 35 radii.
    """
    fx, radius = Range(1400.0, 2200.0).draw(rng), Range(2.0, 10.0).draw_log(rng)
    offset = Range(2.0, 4.0).draw(rng) * np.exp(1j * rng.uniform(-np.pi, np.pi))
    direction = lean(rng)
    middle = fx * (offset / 35 + complex(direction[0], direction[1]))
    distortion = (rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), *rng.uniform(-1e-3, 1e-3, 2), 0.0)
    width, height = IMAGE_SIZE
    camera = Camera(
        IMAGE_SIZE, fx, fx * rng.uniform(0.998, 1.002), width / 2 - middle.real, height / 2 - middle.imag, distortion
    )
    beam = Beam(radius, (float(radius * offset.real), float(radius * offset.imag)), direction)
    rig = Rig(camera, beam, SpotDefinition(kind=kind))
    return replace(rig, covariance=draw_covariance(rng)) if covariance else rig
