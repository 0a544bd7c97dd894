"""theta_a ~ N(mu, T), theta_hat_a ~ N(theta_a, C_a): arms of one model vary by T about mu; the others supply what an arm's own data
leave open.

mu and the diagonal T are found by expectation maximisation (A. Dempster, N. Laird, D. Rubin, JRSS B 39(1), 1977) with the weights of
Student's t (K. Lange, R. Little, J. Taylor, JASA 84(408), 1989), so that a deviating arm does not widen the spread of the others. The
shrinkage estimate is (C_a^-1 + T^-1)^-1 (C_a^-1 theta_hat_a + T^-1 mu). An arm is compared with mu and T of the others alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtr

from calib.regression.normal_equations import inverse
from logs.normal import OF_MEDIAN

LEAST = 4  # arms of a model, from which a spread can be distinguished from chance
FREEDOM = 4.0  # of Student's t
ROUNDS = 200
OUTLIER = 4.0  # standard deviations: 1 in 16000 by chance, for some ten thousand numbers of a fleet
FLOOR = 1e-4  # of a parameter's scale: least spread
# Student's weights underestimate the spread of arms that vary normally: s^2 with E[(f + 1) u^2/(f s^2 + u^2)] = 1, u ~ N(0, 1)
SMALLER = 0.69057


@dataclass(frozen=True)
class Siblings:
    """Joint estimate of p parameters from A arms of one model.

    mean (p,), spread (p,): of the arms, as standard deviation. shrunk (A, p), std (A, p), covariance (A, p, p): each arm's estimate with
    the others' help. score (A, p): how many standard deviations an arm's own estimate is from what the others predict, its own uncertainty
    included. borrowed (A, p): share of an arm's knowledge that comes from the others.
    """

    mean: np.ndarray
    spread: np.ndarray
    shrunk: np.ndarray
    std: np.ndarray
    covariance: np.ndarray
    score: np.ndarray
    borrowed: np.ndarray


def compare(theta: np.ndarray, covariance: Sequence[np.ndarray]) -> Siblings | None:
    """The comparison of A arms, theta (A, p), covariance A x (p, p); None where there are fewer than LEAST."""
    arms, _ = theta.shape
    if arms < LEAST:
        return None
    own = np.array([np.sqrt(np.diag(c)) for c in covariance])
    scale = np.maximum(np.median(np.abs(theta), axis=0), np.median(own, axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    x = theta / scale
    precision = np.array([inverse(c / np.outer(scale, scale)) for c in covariance])
    mean, variance, weight = _settle(x, precision)
    shrunk, posterior = np.empty_like(x), np.empty_like(precision)
    score = np.empty_like(x)
    for a in range(arms):
        posterior[a] = np.linalg.inv(precision[a] + np.diag(1 / variance))
        shrunk[a] = posterior[a] @ (precision[a] @ x[a] + mean / variance)
        pull = posterior[a] / variance  # and the mean itself is known to variance / arms only
        posterior[a] += (pull * variance / arms) @ pull.T
        others, spread = _without(x, own / scale, weight, a)
        score[a] = _normal((x[a] - others) / np.sqrt(spread + (own[a] / scale) ** 2), arms - 2)
    std = np.sqrt(np.array([np.diag(p) for p in posterior])) * scale
    return Siblings(
        mean * scale, np.sqrt(variance) * scale, shrunk * scale, std, posterior * np.outer(scale, scale),
        score, np.clip(1 - (std / own) ** 2, 0.0, 1.0),
    )  # fmt: skip


def _settle(x: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """mu (p,), diagonal of T (p,) and the weights (A, p) of the arms."""
    arms, p = x.shape
    known = np.array([1 / np.maximum(np.diag(c), 1e-300) for c in np.linalg.inv(precision)])
    mean = _weighted_median(x, known)
    variance = np.maximum((OF_MEDIAN * np.median(np.abs(x - mean), axis=0)) ** 2, FLOOR**2)
    weight = np.ones((arms, p))
    for _ in range(ROUNDS):
        prior = weight / variance
        posterior = np.linalg.inv(precision + np.eye(p) * prior[:, None, :])
        middle = np.einsum("aij,aj->ai", posterior, np.einsum("aij,aj->ai", precision, x) + prior * mean)
        uncertain = np.einsum("aii->ai", posterior)
        square = (middle - mean) ** 2 + uncertain
        weight = (FREEDOM + 1) / (FREEDOM + square / variance)
        before = mean, variance
        mean = (weight * middle).sum(axis=0) / weight.sum(axis=0)
        variance = np.maximum((weight * ((middle - mean) ** 2 + uncertain)).mean(axis=0), FLOOR**2)
        moved = np.abs(mean - before[0]) / np.sqrt(variance)
        if moved.max() < 1e-6 and np.abs(np.log(variance / before[1])).max() < 1e-6:
            break
    return mean, variance / SMALLER * arms / (arms - 1), weight


def _without(x: np.ndarray, own: np.ndarray, weight: np.ndarray, a: int) -> tuple[np.ndarray, np.ndarray]:
    """mu, and T plus the variance of mu, of all arms but a, parameter by parameter: precise arms count more, outlying arms less."""
    others = np.arange(len(x)) != a
    y, s2, w = x[others], own[others] ** 2, weight[others]
    variance = np.full(x.shape[1], FLOOR**2)
    mean = _weighted_median(y, 1 / s2)
    for _ in range(20):
        trust = w / (variance + s2)
        mean = (trust * y).sum(axis=0) / trust.sum(axis=0)
        excess = (trust * ((y - mean) ** 2 / SMALLER - s2)).sum(axis=0) / trust.sum(axis=0)
        variance = np.maximum(excess, FLOOR**2)
    return mean, variance + 1 / (w / (variance + s2)).sum(axis=0)


def _normal(t: np.ndarray, freedom: int) -> np.ndarray:
    """The standard normal score that is as rare as t of Student's t with `freedom`: the spread of few arms is hardly known."""
    return -np.sign(t) * ndtri(np.maximum(stdtr(freedom, -np.abs(t)), 1e-300))


def _weighted_median(x: np.ndarray, weight: np.ndarray) -> np.ndarray:
    order = np.argsort(x, axis=0)
    total = np.cumsum(np.take_along_axis(weight, order, axis=0), axis=0)
    middle = np.argmax(total >= 0.5 * total[-1], axis=0)
    return np.take_along_axis(x, np.take_along_axis(order, middle[None], axis=0), axis=0)[0]
