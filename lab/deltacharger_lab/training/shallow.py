# SPDX-License-Identifier: Apache-2.0
"""Training with scikit-learn and XGBoost, and export to arrays."""

import itertools
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_lab.training.classifier import Arrays, Labels, Learnt, Progress
from deltacharger_lab.training.inputs import POSE
from deltacharger_tactile import features
from deltacharger_tactile.classifiers.runtime import softmax


def train(name: str, inputs: Array, labels: Labels, seed: int, progress: Progress) -> Learnt:
    """Train the classifier `name` on inputs (N, F) with labels (N,), which include every class from 0 on."""
    progress(0.0, f"{name}: {len(inputs)} frames")
    build, export = _KNOWN[name]
    model = build(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # about defaults that scikit-learn may change later
        model.fit(inputs, labels)
    kind, arrays = export(model, inputs, labels)
    progress(1.0, f"{name}: done")
    return Learnt(kind, arrays, getattr(model, "predict_proba", None) or (lambda values: _shares(model, values)))


def _shares(model: Any, inputs: Array) -> Array:
    """Probabilities for a model without them: normalised logistic of each class's margin."""
    each = 1.0 / (1.0 + np.exp(-np.clip(model.decision_function(inputs), -500.0, 500.0)))
    return np.asarray(each / each.sum(axis=1, keepdims=True))


def _logistic(seed: int) -> Any:
    from sklearn.linear_model import LogisticRegressionCV
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    return make_pipeline(StandardScaler(), LogisticRegressionCV(Cs=5, cv=5, max_iter=1000, random_state=seed))


def _svm(seed: int) -> Any:
    from sklearn.linear_model import SGDClassifier

    return SGDClassifier(loss="hinge", random_state=seed)


def _knn(seed: int) -> Any:
    from sklearn.neighbors import KNeighborsClassifier

    return KNeighborsClassifier(n_neighbors=5, algorithm="brute")


def _tree(seed: int) -> Any:
    from sklearn.tree import DecisionTreeClassifier

    return DecisionTreeClassifier(random_state=seed)


def _gbdt(seed: int) -> Any:
    from sklearn.ensemble import GradientBoostingClassifier

    return GradientBoostingClassifier(random_state=seed)


def _forest(seed: int) -> Any:
    from sklearn.ensemble import RandomForestClassifier

    return RandomForestClassifier(n_estimators=100, random_state=seed)


def _xgboost(seed: int) -> Any:
    from xgboost import XGBClassifier

    return XGBClassifier(random_state=seed)


def _lda(seed: int) -> Any:
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    return make_pipeline(StandardScaler(), LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto"))


class _Witnesses:
    """Discriminant analyses of features, estimated pose and hidden layer of a network, with their odds multiplied.

    One joint analysis is worse: the features need shrinkage, which spoils the estimate.
    """

    def fit(self, inputs: Array, labels: Labels) -> None:
        ends = [0, len(features.names()), len(features.names()) + POSE, inputs.shape[1]]
        self.parts = [slice(start, end) for start, end in itertools.pairwise(ends) if start < end]
        self.models = [_lda(0) for _ in self.parts]
        self.usual = np.nanmean(inputs, axis=0)
        known = self._known(inputs)
        for model, part in zip(self.models, self.parts, strict=True):
            model.fit(known[:, part], labels)

    def _known(self, inputs: Array) -> Array:
        return np.where(np.isnan(inputs), self.usual, inputs)

    def predict_proba(self, inputs: Array) -> Array:
        known = self._known(inputs)
        odds = [model.predict_log_proba(known[:, part]) for model, part in zip(self.models, self.parts, strict=True)]
        return softmax(np.sum(odds, axis=0))


def _export_scaled(model: Any, inputs: Array, labels: Labels) -> tuple[str, Arrays]:
    """Fold the scaling of a pipeline into its linear model."""
    scaler, line = model.steps[0][1], model.steps[1][1]
    weights = line.coef_.T / scaler.scale_[:, None]
    return "linear", {"weights": weights, "bias": line.intercept_ - scaler.mean_ @ weights}


def _export_witnesses(model: Any, inputs: Array, labels: Labels) -> tuple[str, Arrays]:
    parts = [_export_scaled(part, inputs, labels)[1] for part in model.models]
    weights = np.concatenate([part["weights"] for part in parts])
    bias = np.sum([part["bias"] for part in parts], axis=0)
    return "linear", {"weights": weights, "bias": bias, "usual": model.usual, **_means(inputs, labels)}


def _export_lda(model: Any, inputs: Array, labels: Labels) -> tuple[str, Arrays]:
    kind, arrays = _export_scaled(model, inputs, labels)
    return kind, {**arrays, **_means(inputs, labels)}


def _means(inputs: Array, labels: Labels) -> Arrays:
    return {"means": np.array([np.nanmean(inputs[labels == number], axis=0) for number in range(labels.max() + 1)])}


def _export_svm(model: Any, inputs: Array, labels: Labels) -> tuple[str, Arrays]:
    return "one_against_rest", {"weights": model.coef_.T, "bias": model.intercept_}


def _export_knn(model: Any, inputs: Array, labels: Labels) -> tuple[str, Arrays]:
    numbers = {"count": np.array(model.n_neighbors), "classes": np.array(labels.max() + 1)}
    return "neighbours", {"examples": inputs, "labels": labels, **numbers}


def _table(trees: Sequence[tuple[NDArray[Any], ...]]) -> Arrays:
    """Concatenate trees, each (feature, threshold, left, right, value), into one table."""
    sizes = [len(tree[0]) for tree in trees]
    root = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int32)
    feature, threshold, left, right, value = (np.concatenate(parts) for parts in zip(*trees, strict=True))
    offset = np.repeat(root, sizes)
    return {
        "feature": feature.astype(np.int32),
        "threshold": threshold,
        "left": (left + offset).astype(np.int32),
        "right": (right + offset).astype(np.int32),
        "value": value,
        "root": root,
    }


def _scikit_tree(tree: Any, value: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    return tree.feature, tree.threshold, np.maximum(tree.children_left, 0), np.maximum(tree.children_right, 0), value


def _export_forest(model: Any, inputs: Array, labels: Labels) -> tuple[str, Arrays]:
    trees = [each.tree_ for each in getattr(model, "estimators_", [model])]
    shares = [tree.value[:, 0] / tree.value[:, 0].sum(axis=1, keepdims=True) for tree in trees]
    table = _table([_scikit_tree(tree, share) for tree, share in zip(trees, shares, strict=True)])
    return "forest", {**table, "strict": np.array(False)}


def _export_gbdt(model: Any, inputs: Array, labels: Labels) -> tuple[str, Arrays]:
    stages = model.estimators_
    trees = [each.tree_ for stage in stages for each in stage]
    table = _table([_scikit_tree(tree, model.learning_rate * tree.value[:, 0]) for tree in trees])
    owner = np.tile(np.arange(stages.shape[1]), stages.shape[0])
    base = model._raw_predict_init(inputs[:1].astype(np.float32))[0]
    return "boosted", {**table, "owner": owner, "base": base, "strict": np.array(False)}


def _export_xgboost(model: Any, inputs: Array, labels: Labels) -> tuple[str, Arrays]:
    import json

    learner = json.loads(model.get_booster().save_raw("json"))["learner"]
    booster = learner["gradient_booster"]["model"]
    trees = []
    for tree in booster["trees"]:
        left, right = (np.array(tree[name]) for name in ("left_children", "right_children"))
        condition = np.array(tree["split_conditions"], dtype=np.float32)  # in a leaf: its value
        feature = np.where(left < 0, -1, np.array(tree["split_indices"]))
        trees.append((feature, condition, np.maximum(left, 0), np.maximum(right, 0), condition[:, None]))
    base = np.array(json.loads(learner["learner_model_param"]["base_score"]), dtype=float).reshape(-1)
    base = np.broadcast_to(base, (int(labels.max()) + 1,))
    return "boosted", {**_table(trees), "owner": np.array(booster["tree_info"]), "base": base, "strict": np.array(True)}


_KNOWN: dict[str, tuple[Callable[[int], Any], Callable[[Any, Array, Labels], tuple[str, Arrays]]]] = {
    "logistic": (_logistic, _export_scaled),
    "svm": (_svm, _export_svm),
    "knn": (_knn, _export_knn),
    "tree": (_tree, _export_forest),
    "gbdt": (_gbdt, _export_gbdt),
    "forest": (_forest, _export_forest),
    "xgboost": (_xgboost, _export_xgboost),
    "lda": (_lda, _export_lda),
    "pose": (lambda seed: _Witnesses(), _export_witnesses),
}
"""Constructor and export of each."""
