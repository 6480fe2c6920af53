"""The Lovász loss is the convex extension of 1 - IoU, by its definitions on tiny images."""

import itertools

import numpy as np
import pytest
import torch

from model.paper.loss import lovasz_jaccard

SHAPE = (2, 3)
PIXELS = range(6)


def jaccard_loss(wrong: set[int], truth: set[int]) -> float:
    """1 - |O - M| / |O + M| for the wrong pixels M of the object O; 0 if nothing is wrong."""
    return 1 - len(truth - wrong) / len(truth | wrong) if truth | wrong else 0.0


def masks() -> list[set[int]]:
    return [{p for p in PIXELS if bits >> p & 1} for bits in range(2 ** len(PIXELS))]


def image(values) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64).reshape(1, *SHAPE)


def as_mask(pixels: set[int]) -> torch.Tensor:
    return image([float(p in pixels) for p in PIXELS])


def random_pairs(seed: int, count: int = 8):
    """Probabilities with some equal values, and a true mask; the first has no object."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        truth = {p for p in PIXELS if index and rng.random() < 0.4}
        yield np.round(rng.random(len(PIXELS)), 1), truth


def errors_of(probability, truth: set[int]) -> np.ndarray:
    return np.array([1 - p if pixel in truth else p for pixel, p in enumerate(probability)])


def test_for_hard_masks_it_is_one_minus_iou():
    for truth, pred in itertools.product(masks()[::5], masks()):
        iou = len(truth & pred) / len(truth | pred) if truth | pred else 1.0
        assert float(lovasz_jaccard(as_mask(pred), as_mask(truth))) == pytest.approx(1 - iou, abs=1e-12)


def test_it_is_the_mean_jaccard_loss_over_all_thresholds_of_the_error():
    # The Lovász extension of a set function J is the integral of J({i: m_i > t}) over t in [0, 1].
    for probability, truth in random_pairs(3):
        errors = errors_of(probability, truth)
        levels = np.unique([0.0, 1.0, *errors])
        integral = sum(
            (high - low) * jaccard_loss({p for p in PIXELS if errors[p] > low}, truth)
            for low, high in itertools.pairwise(levels)
        )
        found = lovasz_jaccard(image(probability), as_mask(truth))
        assert float(found) == pytest.approx(integral, abs=1e-12)


def test_it_is_the_largest_over_all_orders_of_the_pixels():
    # The Jaccard loss is submodular; the extension is then the maximum over its base polytope.
    for probability, truth in random_pairs(4, 4):
        errors = errors_of(probability, truth)
        largest = max(
            sum(
                errors[p] * (jaccard_loss({*order[: i + 1]}, truth) - jaccard_loss({*order[:i]}, truth))
                for i, p in enumerate(order)
            )
            for order in itertools.permutations(PIXELS)
        )
        found = lovasz_jaccard(image(probability), as_mask(truth))
        assert float(found) == pytest.approx(largest, abs=1e-12)


def test_its_gradient_is_that_of_finite_differences():
    rng = np.random.default_rng(5)
    probability = torch.from_numpy(rng.random((3, *SHAPE))).requires_grad_()
    truth = torch.from_numpy((rng.random((3, *SHAPE)) < 0.4).astype(float))
    torch.autograd.gradcheck(lambda p: lovasz_jaccard(p, truth), probability, eps=1e-6, atol=1e-7)


def test_images_of_a_batch_do_not_mix():
    pairs = list(random_pairs(6))
    probability = torch.cat([image(p) for p, _ in pairs])
    truth = torch.cat([as_mask(t) for _, t in pairs])
    each = torch.cat([lovasz_jaccard(image(p), as_mask(t)) for p, t in pairs])
    assert torch.equal(lovasz_jaccard(probability, truth), each)
