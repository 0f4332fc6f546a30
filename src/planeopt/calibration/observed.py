"""Observations to and from `calibration.json`."""

import numpy as np

from planeopt.board import Board, Observations, View
from planeopt.calibration.detection import Detected, ImageStatus
from planeopt.calibration.record import (
    BoardRecord,
    CalibrationFile,
    ImageRecord,
    ObservationsRecord,
    Pair,
    SpotRecord,
    ViewRecord,
)
from planeopt.errors import InputError
from planeopt.spot import Spot, SpotFlag


def observations_record(observations: Observations) -> ObservationsRecord:
    """Return observations as they stand in the file, to the last bit."""
    board = observations.board
    return ObservationsRecord(
        board=BoardRecord(
            squares=board.squares,
            square_mm=board.square_mm,
            marker_mm=board.marker_mm,
            dictionary=board.dictionary,
            legacy=board.legacy,
            first_id=board.first_id,
            window_mm=board.window_mm,
        ),
        image_size=observations.image_size,
        spot=observations.spot,
        pixel_pitch_mm=observations.pixel_pitch_mm,
        views=tuple(_view_record(view) for view in observations.views),
    )


def _view_record(view: View) -> ViewRecord:
    return ViewRecord(
        name=view.name,
        ids=tuple(view.ids.tolist()),
        corners_px=pairs(view.corners),
        sigma_px=tuple(view.sigma.tolist()),
        spot=None if view.spot is None else _spot_record(view.spot),
    )


def _spot_record(spot: Spot) -> SpotRecord:
    return SpotRecord(
        points_px=pairs(spot.points),
        sigma_px=None if spot.sigma is None else tuple(spot.sigma.tolist()),
        kind=spot.kind,
        arc_fraction=spot.arc_fraction,
        contrast=spot.contrast,
        blur_px=spot.blur,
        saturation=spot.saturation,
        noise=spot.noise,
        flags=tuple(flag.name.lower() for flag in spot.flags),
    )


def image_record(image: ImageStatus) -> ImageRecord:
    """Return what became of an image as it stands in the file."""
    return ImageRecord(
        name=image.name,
        status=image.status,
        reason=image.reason,
        n_corners=image.n_corners,
        spot_status=image.spot_status,
        spot_reason=image.spot_reason,
        spot_flags=tuple(flag.name.lower() for flag in image.spot_flags),
        blur_px=float(image.blur),
        marker_share=None if image.marker_share is None else float(image.marker_share),
    )


def detected_from_record(record: CalibrationFile) -> Detected:
    """Return what a calibration started from: what was seen, and what became of each image.

    Raises
    ------
    InputError
        If the record contradicts itself.
    """
    images = tuple(
        ImageStatus(
            name=image.name,
            status=image.status,
            reason=image.reason,
            n_corners=image.n_corners,
            spot_status=image.spot_status,
            spot_reason=image.spot_reason,
            spot_flags=_flags(image.spot_flags, image.name),
            blur=image.blur_px,
            marker_share=image.marker_share,
        )
        for image in record.images
    )
    return Detected(observations_from_record(record), images)


def _flags(names: tuple[str, ...], image: str) -> tuple[SpotFlag, ...]:
    unknown = next((name for name in names if name.upper() not in SpotFlag.__members__), None)
    if unknown is not None:
        raise InputError(f"{image}: the spot has the unknown flag {unknown!r}")
    return tuple(SpotFlag[name.upper()] for name in names)


def pairs(array: np.ndarray) -> tuple[Pair, ...]:
    """Return the rows (N, 2) of an array as tuples."""
    return tuple((float(x), float(y)) for x, y in array)


def observations_from_record(record: CalibrationFile) -> Observations:
    """Return what a calibration started from.

    Raises
    ------
    InputError
        If the record contradicts itself.
    """
    seen = record.observations
    return Observations(
        board=Board(**{name: getattr(seen.board, name) for name in BoardRecord.__struct_fields__}),
        image_size=seen.image_size,
        views=tuple(_view(view) for view in seen.views),
        spot=seen.spot,
        pixel_pitch_mm=seen.pixel_pitch_mm,
    )


def _view(record: ViewRecord) -> View:
    spot = None if record.spot is None else _spot(record.spot, record.name)
    return View(
        record.name, np.array(record.ids, dtype=np.int64), _rows(record.corners_px), np.array(record.sigma_px), spot
    )


def _spot(record: SpotRecord, name: str) -> Spot:
    return Spot(
        points=_rows(record.points_px),
        sigma=None if record.sigma_px is None else np.array(record.sigma_px),
        kind=record.kind,
        arc_fraction=record.arc_fraction,
        contrast=record.contrast,
        blur=record.blur_px,
        saturation=record.saturation,
        noise=record.noise,
        flags=_flags(record.flags, name),
        source=name,
    )


def _rows(values: tuple[Pair, ...]) -> np.ndarray:
    return np.array(values, dtype=np.float64).reshape(-1, 2)
