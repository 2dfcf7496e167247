# SPDX-License-Identifier: Apache-2.0
"""From simulated dockings to a saved model that tells the horizontal misalignment, judged on dockings it never saw.

The same as `deltacharger tactile generate`, `train --model lda --target horizontal` and `evaluate`, as library calls.
Prints how many dockings are learnt from and judge, the model's accuracy beside that of always saying the commonest
class, and how often its answer may be acted on. All data are simulated. Training needs deltacharger[train]; the saved
model runs on numpy alone.

    python examples/train_a_model.py [model.npz]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.classifiers.judgement import evaluate
from deltacharger_tactile.classifiers.labels import examples
from deltacharger_tactile.classifiers.splits import by_docking
from deltacharger_tactile.generator import generate_paper

out = Path(sys.argv[1] if len(sys.argv) > 1 else "model.npz")
dockings = examples(generate_paper(rigs=range(5), seed=0), "horizontal")  # five devices, 500 dockings each
learns, judges = by_docking(dockings, seed=0)  # 67/33, as in the paper
fits, calibrates = learns[::2], learns[1::2]  # what tells when to trust it must be new to it, too

model = Classifier("lda", "horizontal")
model.fit(dockings.frames[fits], dockings.labels[fits], seed=0)
model.calibrate(dockings.frames[calibrates], dockings.labels[calibrates], dockings.frames[fits])
model.save(out)

found = evaluate(Classifier.load(out), dockings.part(judges))
commonest = np.bincount(dockings.labels[judges]).max() / len(judges)
print(f"{out}: learnt from {len(learns)} simulated dockings, judged on {len(judges)} others")
print(f"accuracy {100 * found['accuracy']:.1f} %; always the commonest class {100 * commonest:.1f} %")
print(f"may be acted on in {100 * found['act_rate']:.1f} %")
