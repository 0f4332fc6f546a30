"""The posterior as JSON: all keys, plain numbers, the draws' own."""

import json
import math
import pickle

import msgspec
import numpy as np
import pytest

from example_rig import example_rig, pose_at, spot_of
from planeopt import Posterior, sample_posterior
from planeopt.posterior import PosteriorRecord, posterior_record, sample_problem
from posterior_cases import seen, spot_through, uncertain_rig


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    return sample_posterior(spot_of(pose_at()), example_rig(), draws=300)


def test_it_survives_json(posterior: Posterior) -> None:
    record = posterior_record(posterior)
    text = json.dumps(msgspec.to_builtins(record), allow_nan=False)
    assert msgspec.convert(json.loads(text), PosteriorRecord) == record


def test_its_numbers_are_the_draws_own(posterior: Posterior) -> None:
    record = posterior_record(posterior)
    assert record.z_L_mm.median == np.median(posterior.samples[:, 0])
    assert record.alpha_deg.high95 == pytest.approx(np.degrees(np.quantile(posterior.quantities["alpha"], 0.975)))
    assert record.beta_deg is not None
    assert record.beta_deg.median == pytest.approx(math.degrees(0.8), abs=0.5)
    assert record.a_mm is not None
    assert record.normal_deg.radius68 < record.normal_deg.radius95
    assert record.n_samples == len(posterior)
    np.testing.assert_allclose(record.covariance, posterior.covariance)
    assert record.split.normal_deg.calibration == 0
    assert record.diagnostics.stopped == "converged"
    assert record.laplace.agrees
    assert record.prior.sentence == posterior.prior_sentence
    assert not record.prior.dominated


def test_what_has_no_value_is_null() -> None:
    record = posterior_record(sample_problem(seen(alpha=0.0), draws=300))
    assert record.beta_deg is None
    assert record.a_mm is None or record.b_mm is None


def test_an_uncertain_rig_is_named_and_split() -> None:
    rig = uncertain_rig()
    record = posterior_record(sample_posterior(spot_through(rig, 0.3), rig, draws=300))
    assert record.rig_parameters == ("f", "cx", "cy", "e_x", "e_y", "radius", "direction_x", "direction_y")
    assert 0.5 < record.split.z_L_mm.calibration_share < 1
    assert len(record.modes) == 1


def test_a_chain_cut_short_is_valid_json() -> None:
    record = posterior_record(sample_problem(seen(), budget=2))
    assert record.diagnostics.stopped == "budget"
    assert record.diagnostics.r_hat is None
    json.dumps(msgspec.to_builtins(record), allow_nan=False)


def test_it_comes_back_from_another_process(posterior: Posterior) -> None:
    again = pickle.loads(pickle.dumps(posterior))
    assert again.samples.tobytes() == posterior.samples.tobytes()
    assert posterior_record(again) == posterior_record(posterior)
