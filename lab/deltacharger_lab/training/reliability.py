# SPDX-License-Identifier: Apache-2.0
"""When a classifier's answer may be used: split-conformal sets, and a check that frames look as in training.

A conformal set holds the true class with the nominal probability if new frames are distributed like the held-out ones.
The drift check detects when they no longer are.

**The check** uses what a frame shows beyond its pose: its features (load, active taxels, peak, moments,
shares of rows and columns) minus their smooth regression on features that follow the pose (share of each pad's load,
height and slope of the line through both centres). It therefore depends little on the poses of the dockings.
Hotelling's T² measures the remainder. A single frame shows only gross changes; the mean over a window of dockings
also shows slow ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, machine
from deltacharger_lab.training.splits import distinct
from deltacharger_tactile import errors, parameters

WINDOW = 50
"""Fewest dockings judged together."""
FEWEST = 20
"""Fewest frames to learn from; fewer do not show one in twenty."""
_FOLDS = 5
_DRAWS = 2000  # windows drawn from the remainders of training
_TAIL = 0.002  # share of them that may look strange
_MARGIN, _WINDOW_MARGIN = 5.0, 4.0  # over the root of the number of frames: training shows only so many
_BETWEEN = 0.005  # of a frame's variance at 1 N: differences between sessions, such as the tare, common to all frames
_FALSE = 0.01  # share of single frames that may look strange
_COUNTED = 3.6  # largest excess of strange frames in a window, in standard deviations of their count
_NODES = 30  # of the regression, at most; a fifth of the frames if these are few
_BUMP = 0.7  # width of a node's bump, in standard deviations
_PENALTY = 0.3  # on a bump's weight
_LEAST = 0.01  # of any feature's spread, so that one that never varied does not decide
_LIGHT = 5.0  # N, added to a pad's load before dividing: an unloaded pad has no shape
_PITCH = 1e3 * parameters.PadContactParameters().pad_side / machine.ROWS
_AWAY = _PITCH * (0.5 * (machine.ROWS - 1) - np.arange(machine.ROWS))  # of taxel centres from the pad's, mm


@dataclass(frozen=True)
class Familiarity:
    """Statistics of familiar frames; P features that follow the pose, B terms of the regression, F other features.

    Attributes:
        centre: (P,) mean of the features that follow the pose.
        spread: (P,) their standard deviation.
        nodes: (M, P) of the regression, in standard deviations.
        gram: (B, B) inverse of the terms' second moments.
        weights: (B, F) of the regression.
        scale: (F,) standard deviation of the remainders.
        precision: (F, F) inverse covariance of the scaled remainders, shrunk.
        frame_limit: largest familiar T² of one frame.
        load_limit: largest familiar remainder of one frame's total load, in standard deviations.
        reach_limit: largest familiar leverage of one frame: how far its pose may be from those of training.
        window_limit: largest familiar T² of a window's mean.
        feature_limit: largest familiar single feature of a window's mean, in standard deviations.
    """

    centre: arrays.Array
    spread: arrays.Array
    nodes: arrays.Array
    gram: arrays.Array
    weights: arrays.Array
    scale: arrays.Array
    precision: arrays.Array
    frame_limit: float = float("inf")
    load_limit: float = float("inf")
    reach_limit: float = float("inf")
    window_limit: float = float("inf")
    feature_limit: float = float("inf")

    def strange(self, frames: arrays.Array, threshold: float) -> arrays.Mask:
        """Return which frames (N, 2, 10, 10) N look unlike training."""
        return self._strange(*self.remainders(frames, threshold))

    def _strange(self, remainder: arrays.Array, terms: arrays.Array) -> arrays.Mask:
        distance, reach = self._sizes(remainder, terms)
        load = np.abs(remainder[:, 0]) / np.sqrt(1.0 + reach)
        return np.asarray((distance > self.frame_limit) | (reach > self.reach_limit) | (load > self.load_limit))

    def strange_together(self, frames: arrays.Array, threshold: float) -> bool:
        """Return whether frames (N, 2, 10, 10) N of N ≥ WINDOW dockings look, on average, unlike training."""
        remainder, terms = self.remainders(frames, threshold)
        usual = _FALSE * len(frames)  # a count, so its standard deviation is its root
        if np.count_nonzero(self._strange(remainder, terms)) > usual + _COUNTED * np.sqrt(usual):
            return True
        distance, reach = self._sizes(remainder, terms)
        near = reach <= self.reach_limit  # beyond it the regression extrapolates
        capped = _capped(remainder[near], distance[near], self.frame_limit)
        mean, at = capped.mean(axis=0), terms[near].mean(axis=0)
        between = _BETWEEN / np.sqrt(threshold)  # readings near the threshold contain the tare's own error
        variance = 1.0 / max(int(np.sum(near)), 1) + float(at @ self.gram @ at) + between
        together = float(mean @ self.precision @ mean) / variance
        return bool(together > self.window_limit or np.abs(mean).max() > self.feature_limit * np.sqrt(variance))

    def distances(self, frames: arrays.Array, threshold: float) -> tuple[arrays.Array, arrays.Array]:
        """Return T² and leverage of each frame: (N,), (N,)."""
        return self._sizes(*self.remainders(frames, threshold))

    def _sizes(self, remainder: arrays.Array, terms: arrays.Array) -> tuple[arrays.Array, arrays.Array]:
        reach = _squared(terms, self.gram)
        return _squared(remainder, self.precision) / (1.0 + reach), reach

    def remainders(self, frames: arrays.Array, threshold: float) -> tuple[arrays.Array, arrays.Array]:
        """Return the scaled remainders of features (N, F) and the terms (N, B)."""
        posed, other = _features(frames, threshold)
        terms = _terms((posed - self.centre) / self.spread, self.nodes)
        return (other - terms @ self.weights) / self.scale, terms

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, rounded to seven digits."""
        return {item.name: _plain(getattr(self, item.name)) for item in fields(self)}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Familiarity:
        """Restore from the output of `to_dict`."""
        read: dict[str, Any] = {key: np.array(each) if isinstance(each, list) else each for key, each in values.items()}
        return Familiarity(**read)


def learn_familiar(frames: arrays.Array, threshold: float) -> Familiarity:
    """Learn from familiar frames (N, 2, 10, 10) N; limits come from cross-validation.

    Args:
        frames: of one rig or several; the more dockings, the better.
        threshold: readings below it count as 0, N.

    Raises:
        ModelError: too few of them differ and are in contact.
    """
    frames = frames[distinct(frames, threshold)]
    if len(frames) < FEWEST:
        raise errors.ModelError(
            "reliability", f"{len(frames)} different frames in contact are too few; give at least {FEWEST}"
        )
    random = np.random.default_rng(0)  # only for folds and windows
    fold = random.permutation(len(frames)) % _FOLDS
    remainders, whitened, distances, reaches = [], [], [], []
    for index in range(_FOLDS):
        known, unseen = _fit(frames[fold != index], threshold), frames[fold == index]
        remainder, _ = known.remainders(unseen, threshold)
        distance, reach = known.distances(unseen, threshold)
        remainders.append(remainder)
        whitened.append(remainder @ np.linalg.cholesky(known.precision))
        distances.append(distance)
        reaches.append(reach)
    distance, remainder = np.concatenate(distances), np.concatenate(remainders)
    margin, wider = (1.0 + each / np.sqrt(len(frames)) for each in (_MARGIN, _WINDOW_MARGIN))
    frame_limit = margin * float(np.quantile(distance, 1.0 - 0.5 * _FALSE))
    shares = random.multinomial(WINDOW, np.full(len(frames), 1.0 / len(frames)), _DRAWS) / WINDOW
    means = shares @ _capped(np.concatenate(whitened), distance, frame_limit)
    single = np.abs(shares @ _capped(remainder, distance, frame_limit)).max(axis=1)
    return replace(
        _fit(frames, threshold),
        frame_limit=frame_limit,
        load_limit=margin * float(np.abs(remainder[:, 0]).max()),
        reach_limit=margin * float(np.concatenate(reaches).max()),
        window_limit=wider * WINDOW * float(np.quantile(np.sum(means * means, axis=1), 1.0 - _TAIL)),
        feature_limit=float(np.sqrt(wider * WINDOW) * np.quantile(single, 1.0 - _TAIL)),
    )


def _capped(remainder: arrays.Array, distance: arrays.Array, limit: float) -> arrays.Array:
    """Return remainders (N, F), each scaled down to the limit on its distance (N,), so that one cannot decide alone."""
    return np.asarray(remainder * np.sqrt(np.minimum(1.0, limit / np.maximum(distance, 1e-9)))[:, None])


def _fit(frames: arrays.Array, threshold: float) -> Familiarity:
    posed, other = _features(frames, threshold)
    centre, spread = np.asarray(posed.mean(axis=0)), np.asarray(posed.std(axis=0) + 1e-9)
    scaled = (posed - centre) / spread
    nodes = _spread_out(scaled, min(_NODES, len(frames) // 5))
    terms = _terms(scaled, nodes)
    penalty = np.full(terms.shape[1], 1e-6)
    penalty[-len(nodes) :] = _PENALTY
    gram = np.asarray(np.linalg.inv(terms.T @ terms + np.diag(penalty)), dtype=float)
    weights = gram @ terms.T @ other
    remainder = (other - terms @ weights) / np.sqrt(np.maximum(1.0 - _squared(terms, gram), 0.1))[:, None]
    scale = np.asarray(remainder.std(axis=0) + _LEAST)
    precision = np.asarray(np.linalg.inv(_shrunk(remainder / scale)), dtype=float)
    return Familiarity(centre, spread, nodes, gram, weights, scale, precision)


def _squared(values: arrays.Array, form: arrays.Array) -> arrays.Array:
    """Return the quadratic form (F, F) of each row of values (N, F)."""
    return np.asarray(np.einsum("ni,ni->n", values @ form, values))


def _shrunk(values: arrays.Array) -> arrays.Array:
    """Return the covariance of centred values (N, F), shrunk to a multiple of the unit (Ledoit and Wolf 2004)."""
    count, width = values.shape
    covariance = values.T @ values / count
    level = float(np.trace(covariance)) / width
    error = float(np.mean(np.sum(values * values, axis=1) ** 2) - np.sum(covariance * covariance)) / count
    share = min(1.0, error / float(np.sum((covariance - level * np.eye(width)) ** 2)))
    return np.asarray((1.0 - share) * covariance + share * level * np.eye(width))


def _features(frames: arrays.Array, threshold: float) -> tuple[arrays.Array, arrays.Array]:
    """Return features that follow the pose (N, 3) and the others (N, F): N, mm, their logarithms and ratios."""
    seen = np.where(frames >= threshold, frames, 0.0)
    rows, columns = seen.sum(axis=3), seen.sum(axis=2)
    load = rows.sum(axis=2)
    weight = load + _LIGHT
    u, v = columns @ _AWAY / weight, rows @ _AWAY / weight
    width, height = (columns @ _AWAY**2 / weight - u * u, rows @ _AWAY**2 / weight - v * v)
    tilt = np.einsum("npij,i,j->np", seen, _AWAY, _AWAY) / weight - u * v
    sides = (load[:, 0] - load[:, 1]) / weight.sum(axis=1)
    posed = np.stack([sides, v.mean(axis=1), v[:, 0] - v[:, 1]], axis=1)
    total = np.log(load.sum(axis=1, keepdims=True) + _LIGHT)
    active = np.count_nonzero(seen, axis=(2, 3))
    shape = (u, np.sqrt(np.maximum(width, 0.0)), np.sqrt(np.maximum(height, 0.0)), tilt, seen.max(axis=(2, 3)) / weight)
    heights = (rows / weight[:, :, None]).reshape(len(seen), -1)
    shares = (columns / weight[:, :, None]).reshape(len(seen), -1)
    return posed, np.concatenate([total, active, *shape, heights, shares], axis=1)


def _terms(values: arrays.Array, nodes: arrays.Array) -> arrays.Array:
    """Return 1, the values (N, P), their products and a bump around each node (M, P): (N, B)."""
    first, second = np.triu_indices(values.shape[1])
    squared = np.sum((values[:, None] - nodes) ** 2, axis=2)
    bumps = np.exp(-0.5 * squared / _BUMP**2)
    return np.column_stack([np.ones(len(values)), values, values[:, first] * values[:, second], bumps])


def _spread_out(values: arrays.Array, count: int) -> arrays.Array:
    """Return `count` of the values (N, P), each the farthest from the earlier ones."""
    chosen = [int(np.argmin(np.sum(values * values, axis=1)))]
    nearest = np.full(len(values), np.inf)
    while len(chosen) < count:
        nearest = np.minimum(nearest, np.sum((values - values[chosen[-1]]) ** 2, axis=1))
        chosen.append(int(np.argmax(nearest)))
    return values[chosen]


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        rounded = [float(f"{each:.7g}") for each in value.ravel()]
        return np.reshape(rounded, value.shape).tolist()
    return value


NOMINAL = 0.95


@dataclass(frozen=True)
class Reliability:
    """Results from held-out frames.

    Attributes:
        quantile: largest 1 − probability of a class in the set.
        familiar: statistics of training frames.
    """

    quantile: float
    familiar: Familiarity

    def sets(self, probabilities: arrays.Array) -> arrays.Mask:
        """Return which classes (N, C) belong to the set of each frame; a set may be empty."""
        return np.asarray(1.0 - probabilities <= self.quantile)

    def drifted_together(self, frames: arrays.Array, threshold: float) -> bool:
        """Return whether the last dockings together look unlike training, though each alone may not.

        Args:
            frames: (N, 2, 10, 10) N, one per docking.
            threshold: readings below it count as 0, N.

        Raises:
            ModelError: too few frames.
        """
        if len(frames) < WINDOW:
            raise errors.ModelError(
                "reliability", f"{len(frames)} dockings are too few to judge; give at least {WINDOW}"
            )
        return self.familiar.strange_together(frames, threshold)

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers."""
        return {"quantile": self.quantile, "familiar": self.familiar.to_dict()}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Reliability:
        """Restore from the output of `to_dict`."""
        return Reliability(values["quantile"], Familiarity.from_dict(values["familiar"]))


def learn(
    probabilities: arrays.Array,
    labels: NDArray[np.int64],
    frames: arrays.Array,
    threshold: float,
    familiar: arrays.Array | None = None,
) -> Reliability:
    """Learn from frames that training did not see (Vovk et al. 2005; score 1 − probability of the true class).

    Args:
        probabilities: (N, C) by the classifier.
        labels: (N,) their classes.
        frames: (N, 2, 10, 10) N.
        threshold: readings below it count as 0, N.
        familiar: (M, 2, 10, 10) N, further normal frames. Training frames may be used: the drift check does not use the
            classifier's output.

    Raises:
        ModelError: too few frames, or too few of them differ and are in contact.
    """
    count = len(labels)
    if count < FEWEST:
        raise errors.ModelError("reliability", f"{count} held-out frames are too few; give at least {FEWEST}")
    scores = np.sort(1.0 - probabilities[np.arange(count), labels])
    rank = math.ceil((count + 1) * NOMINAL)
    quantile = float(scores[rank - 1]) if rank <= count else 1.0
    every = frames if familiar is None else np.concatenate([frames, familiar])
    return Reliability(quantile, learn_familiar(every, threshold))
