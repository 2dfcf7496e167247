# SPDX-License-Identifier: Apache-2.0
"""The paper's nine classifiers of misalignment, and one on physical features, behind one interface.

They are trained with scikit-learn, XGBoost or PyTorch, and run on numpy alone.
"""
