"""Temperature scaling of the mask's logits: the fit, and what it changes in a run."""

import numpy as np
import pytest
import torch
from scipy.optimize import minimize_scalar
from scipy.special import expit
from training_runs import FLIP, train_on_one_thread

from model.prediction.predictor import load
from model.training.uncertainty_fit import LogitCount, logit_factor

PROBABLE = FLIP | {"target": "mask+depth", "width": 8, "batch_size": 2, "block": 2}
PROBABLE |= {"max_epochs": 5, "learning_rate": 2e-3, "average_flip": True}

pytestmark = pytest.mark.usefixtures("one_thread")


def cross_entropy(factor, logit, shown):
    return np.mean(np.logaddexp(0, factor * logit) - shown * factor * logit)


def counted(logit, shown, parts=1):
    count = LogitCount(torch.device("cpu"))
    for place in np.array_split(np.arange(len(logit)), parts):
        count.add(torch.from_numpy(logit[place]), torch.from_numpy(shown[place].astype(np.float32)))
    return count.sums


@pytest.mark.parametrize("true_factor", [0.05, 0.3, 1.0, 4.0])
def test_the_factor_is_the_one_that_minimises_the_cross_entropy(true_factor):
    rng = np.random.default_rng(0)
    logit = rng.normal(-1, 2, 200_000) / true_factor
    shown = rng.random(len(logit)) < expit(true_factor * logit)
    best = minimize_scalar(cross_entropy, (0.01, 10), args=(logit, shown), method="brent").x
    found = logit_factor(counted(logit, shown, parts=7))
    assert found == pytest.approx(best, rel=2e-3)  # the logits are counted in bins
    # 200,000 draws, of which a tenth is near the threshold: 1 / sqrt(20,000) = 0.7 %, four times that.
    assert found == pytest.approx(true_factor, rel=0.03)
    torch.testing.assert_close(counted(logit, shown, parts=7), counted(logit, shown))


def test_pixels_of_one_kind_leave_the_logits_as_they_are():
    logit = np.linspace(-3, 3, 50)
    for shown in (np.zeros(50, bool), np.ones(50, bool)):
        assert logit_factor(counted(logit, shown)) == 1.0
    assert logit_factor(torch.zeros(3, 4096, dtype=torch.float64)) == 1.0


def test_the_kept_weights_have_the_factor_of_their_epoch_and_the_same_masks(
    closed_form_scenes, tmp_path, shards, monkeypatch
):
    run = train_on_one_thread(closed_form_scenes, tmp_path / "run", **PROBABLE)
    monkeypatch.setattr("model.training.uncertainty_fit.logit_factor", lambda sums: 1.0)
    plain = train_on_one_thread(closed_form_scenes, tmp_path / "plain", **PROBABLE)
    scaled, before = load(run, "cpu"), load(plain, "cpu")
    weights, others = (each.network.state_dict() for each in (scaled, before))
    last = f"head.{len(scaled.network.head) - 1}"
    factor = float(weights[f"{last}.bias"][0] / others[f"{last}.bias"][0])
    assert factor != 1
    for name, weight in weights.items():
        if name.startswith(last):
            torch.testing.assert_close(weight[0], factor * others[name][0])
            assert torch.equal(weight[1], others[name][1])
        else:
            assert torch.equal(weight, others[name])
    block = shards.read(shards.rows("validation"))
    found, unscaled = (each.predict(block.phasors) for each in (scaled, before))
    np.testing.assert_array_equal(found.mask, unscaled.mask)
    np.testing.assert_allclose(found.radial_depth_m, unscaled.radial_depth_m, atol=1e-5)
    logit = np.log(np.abs(unscaled.phasor) / (1 - np.abs(unscaled.phasor))).ravel().astype(np.float64)
    shown = (block.mask > 0).ravel()
    best = minimize_scalar(cross_entropy, (0.01, 10), args=(logit, shown), method="brent").x
    assert factor == pytest.approx(best, rel=2e-3)  # as above
