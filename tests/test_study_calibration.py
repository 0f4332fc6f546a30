"""The calibration study: its quick form is run and held to what is asked; its full form is read from its tables."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from planeopt.rig import BEAM_PARAMETERS
from planeopt.simulation import random_session
from studies import calibration
from studies.__main__ import RESULTS
from studies.calibration_accuracy import RATIOS, TILTS_DEG, VIEWS, AccuracyRow
from studies.calibration_fits import QUANTITIES, fit_default, independent, joint_chi2, truth_of
from studies.calibration_images import ImageRow
from studies.calibration_judged import Judged, judge, pooled
from studies.calibration_models import BOWED, FLAT, KINDS, OBLIQUE, TANGENTIAL, ModelRow, session_of
from studies.calibration_repeats import DrawRow
from studies.calibration_sessions import DEFAULT, MODELS, SessionRow
from studies.calibration_summary import summarised
from studies.statistics import LEVEL
from studies.study import Result, read_rows
from study_files import written

COMMITTED = RESULTS / "calibration"
AGREEMENT = 0.15
"""How far what is reported may be from the scatter of repeats, by the issue that this answers."""


@dataclass(frozen=True)
class Tables:
    sessions: Sequence[SessionRow]
    images: Sequence[ImageRow]
    draws: Sequence[DrawRow]
    accuracy: Sequence[AccuracyRow]
    models: Sequence[ModelRow]

    @property
    def judged(self) -> Judged:
        return judge(self.sessions, self.images, self.draws)


KINDS_OF_ROWS = {
    "sessions": SessionRow,
    "images": ImageRow,
    "draws": DrawRow,
    "accuracy": AccuracyRow,
    "models": ModelRow,
}


@pytest.fixture(scope="module")
def committed() -> Tables:
    return Tables(**{name: read_rows(COMMITTED / f"{name}.csv", kind) for name, kind in KINDS_OF_ROWS.items()})


def complaints(tables: Tables) -> Iterator[str]:
    """Everything that is asked and does not hold."""
    judged = tables.judged
    yield from (f"{row}" for row in (*judged.coverage, *judged.joint, *judged.repeats) if not row.within)
    # Nobody is left out: whatever a session was like, it gives a rig.
    yield from (f"{row.seed}: {row.outcome}" for row in tables.sessions if row.outcome != "calibrated")
    yield from (f"{row.seed}: {row.outcome}" for row in tables.images if np.isnan(row.f_sigmas))


@pytest.fixture(scope="module")
def quick() -> Result:
    return calibration.run("quick")


def test_the_quick_study(quick: Result, tmp_path: Path) -> None:
    written(quick, tmp_path, COMMITTED)
    tables = Tables(**{name: quick.tables[name] for name in KINDS_OF_ROWS})  # pyright: ignore[reportArgumentType]
    assert not list(complaints(tables)), "\n".join(complaints(tables))


def test_the_full_study_as_committed(committed: Tables) -> None:
    assert not list(complaints(committed)), "\n".join(complaints(committed))
    assert sum(row.model == DEFAULT for row in committed.sessions) >= 200
    assert {row.model for row in committed.sessions} == set(MODELS)
    assert len(committed.images) >= 20
    for name, row in pooled(committed.judged).items():
        assert abs(row.ratio - 1) < AGREEMENT, name
        # There are draws enough for that to mean something.
        assert row.most - 1 < AGREEMENT


def test_what_the_full_study_says_of_accuracy(committed: Tables) -> None:
    def sigma(varied: str, value: float, name: str) -> float:
        rows = [row for row in committed.accuracy if (row.varied, row.value) == (varied, value)]
        assert rows
        return float(np.median([getattr(row, name) for row in rows]))

    for varied, values in (("views", VIEWS), ("tilt", TILTS_DEG), ("depths", RATIOS)):
        assert {row.value for row in committed.accuracy if row.varied == varied} == {float(value) for value in values}
    assert sigma("tilt", TILTS_DEG[0], "f_relative") > 10 * sigma("tilt", TILTS_DEG[-1], "f_relative")
    assert sigma("depths", RATIOS[0], "offset_mm") > 4 * sigma("depths", 2.0, "offset_mm")
    assert sigma("views", 40, "f_relative") < 0.5 * sigma("views", 6, "f_relative")
    # What a plane suffers falls with the views and tilts; of its own spot's noise it does not depend on either.
    assert sigma("views", 40, "normal_deg") < 0.5 * sigma("views", 3, "normal_deg")
    assert sigma("tilt", TILTS_DEG[0], "z_L_relative") > 10 * sigma("tilt", TILTS_DEG[-1], "z_L_relative")
    assert sigma("views", 40, "normal_spot_deg") == pytest.approx(sigma("views", 6, "normal_spot_deg"), rel=0.25)


def test_what_the_full_study_says_of_models(committed: Tables) -> None:
    rows = {(row.case, row.model): row for row in summarised(committed.models)}
    assert set(rows) == set(KINDS)
    # What is there and has no place moves the rest far beyond what is said.
    for case, model in ((BOWED, "taken as flat"), (TANGENTIAL, "dropped"), (OBLIQUE, "taken as parallel")):
        assert rows[case, model].worst_95 < 0.7
    for case, model in (
        (BOWED, "bow free"),
        (FLAT, "bow free"),
        (TANGENTIAL, "kept"),
        (TANGENTIAL, "default"),
        (OBLIQUE, "direction free"),
    ):
        assert rows[case, model].covered_95 > 0.9
    # A test that decides what is free leaves intervals that are too short.
    assert rows[TANGENTIAL, "chosen by its test"].worst_95 < rows[TANGENTIAL, "kept"].worst_95
    oblique = rows[OBLIQUE, "direction free"]
    assert abs(oblique.off_axis_mrad - 5) < 4 * oblique.off_axis_sigma_mrad
    # Places for a bow where there is none cost little.
    assert rows[FLAT, "bow free"].f_relative < 1.3 * rows[FLAT, "taken as flat"].f_relative


def test_the_committed_numbers_are_those_of_this_code(committed: Tables, quick: Result) -> None:
    """The quick form's sessions are the first of the full form's."""
    known = {(row.seed, row.model): row for row in committed.sessions}
    of_quick = [row for row in quick.tables["sessions"] if isinstance(row, SessionRow)]
    assert {row.model for row in of_quick} == set(MODELS)
    for again in of_quick:
        before = known[again.seed, again.model]
        assert (again.views, again.dof) == (before.views, before.dof)
        for name in QUANTITIES:
            assert getattr(again, f"{name}_sigmas") == pytest.approx(getattr(before, f"{name}_sigmas"), abs=0.01)


def session_rows(scale: float, count: int) -> list[SessionRow]:
    """Rows of a calibration whose standard deviations are off by a factor."""
    rng = np.random.default_rng(5)
    rows = []
    for seed, errors in enumerate((rng.standard_normal((count, 13)) * scale).tolist()):
        names = {f"{name}_sigmas": error for name, error in zip(QUANTITIES, errors, strict=False)}
        chi2 = float(np.sum(np.square(errors)))
        p_value = float(scipy.stats.chi2.sf(chi2, 13))
        nothing = dict.fromkeys(("z_L_apart", "p_apart", "q_apart", "z_L_sigma_mm", "z_L_apart_mm"), 1.0)
        pose = dict.fromkeys(("z_L_sigmas", "p_sigmas", "q_sigmas"), errors[-1])
        common = {"seed": seed, "outcome": "calibrated", "views": 10, "corner_sigma_px": 0.1, "f_relative": 1e-3}
        row = SessionRow(**names, **pose, **nothing, **common, model=DEFAULT, chi2=chi2, dof=13, p_value=p_value)
        rows += [row, replace(row, model=MODELS[1])]
    return rows


@pytest.mark.parametrize(("scale", "honest"), [(0.75, False), (1.0, True), (1.33, False)])
def test_dishonest_covariances_are_seen(scale: float, honest: bool) -> None:
    """Standard deviations a third too large or too small fail, with as many sessions as the study has."""
    rng = np.random.default_rng(6)
    draws = []
    for draw, errors in enumerate((scale * rng.standard_normal((600, len(QUANTITIES)))).tolist()):
        values = dict(zip(QUANTITIES, errors, strict=True))
        own = {f"{name}_own": 1.0 for name in QUANTITIES}
        draws.append(DrawRow(draw % 6, draw, **values, **own, chi2=sum(e * e for e in errors), dof=len(errors)))
    images = [
        ImageRow(
            **{name: value for name, value in vars(row).items() if name in ImageRow.__dataclass_fields__},
            used=10,
            spots=10,
            corners=500,
            share=1.0,
            corner_px=0.01,
            corner_factor=1.0,
            spot_factor=1.0,
            blur_px=1.0,
        )
        for row in session_rows(scale, 20)[::2]
    ]
    judged = judge(session_rows(scale, 200), images, draws)
    assert all(row.within for row in (*judged.coverage, *judged.joint, *judged.repeats)) is honest
    assert (judged.kept == judged.tests) is honest
    assert all(row.within for row in pooled(judged).values()) is honest
    assert judged.joint[0].least_p == pytest.approx(LEVEL / judged.tests)


def test_cases_have_what_they_say() -> None:
    bowed, oblique = session_of(BOWED, 0), session_of(OBLIQUE, 0)
    assert max(bowed.warp) == 0.5
    assert np.hypot(*oblique.rig.require_beam().direction[:2]) == pytest.approx(5e-3)
    assert oblique.rig.camera.distortion[4] == 0
    assert sum(view.spot is not None for view in oblique.observations.views) >= 8


def test_camera_and_beam_apart() -> None:
    session = random_session(3)
    rig = fit_default(session.observations).rig
    apart = independent(rig)
    assert rig.covariance is not None
    assert apart.covariance is not None
    assert np.array_equal(apart.covariance.sigmas, rig.covariance.sigmas)
    beam = np.isin(rig.covariance.parameters, BEAM_PARAMETERS)
    assert np.all(apart.covariance.matrix[np.ix_(beam, ~beam)] == 0)
    names = rig.covariance.parameters
    at = names.index("direction_x"), names.index("cx")
    assert rig.covariance.correlation[at] < -0.9
    chi2, dof = joint_chi2(rig, {name: rig.parameter(name) for name in names} | {"f": rig.parameter("f")})
    assert (chi2, dof) == (0.0, len(names))
    assert joint_chi2(rig, truth_of(session))[0] < scipy.stats.chi2.isf(LEVEL / 100, dof)
