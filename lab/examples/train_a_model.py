# SPDX-License-Identifier: Apache-2.0
"""From simulated dockings to a saved model of the horizontal misalignment, evaluated on held-out dockings.

Library calls for `generate`, `train --model lda --target horizontal` and `evaluate` of `python -m
deltacharger_lab.training`. Prints the numbers of dockings for training and evaluation, the accuracies of the model and
of always choosing the commonest class, and how often a prediction may be acted on. All data are simulated.
Training needs deltacharger-lab[train]; the saved model needs only numpy.

    python lab/examples/train_a_model.py [model.npz]
"""

import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from deltacharger_lab.training import classifier, judgement, labels, splits
from deltacharger_sim.pads import generate_paper

if find_spec("sklearn") is None:
    sys.exit("scikit-learn is not installed: `make trainers`, or `pip install 'deltacharger-lab[train]'`")
out = Path(sys.argv[1] if len(sys.argv) > 1 else "model.npz")
dockings = labels.examples(generate_paper(rigs=range(5), seed=0), "horizontal")  # five devices, 500 dockings each
learns, judges = splits.by_docking(dockings, seed=0)  # 67/33, as in the paper
fits, calibrates = learns[::2], learns[1::2]  # calibration needs dockings that were not used for the fit

model = classifier.TrainableClassifier("lda", "horizontal")
model.fit(dockings.frames[fits], dockings.labels[fits], seed=0)
model.calibrate(dockings.frames[calibrates], dockings.labels[calibrates], dockings.frames[fits])
model.save(out)

found = judgement.evaluate_classifier(classifier.TrainableClassifier.load(out), dockings.part(judges))
commonest = np.bincount(dockings.labels[judges]).max() / len(judges)
print(f"{out}: learnt from {len(learns)} simulated dockings, judged on {len(judges)} others")
print(f"accuracy {100 * found['accuracy']:.1f} %; always the commonest class {100 * commonest:.1f} %")
print(f"may be acted on in {100 * found['act_rate']:.1f} %")
