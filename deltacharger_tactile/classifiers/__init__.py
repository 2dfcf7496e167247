# SPDX-License-Identifier: Apache-2.0
"""The paper's nine classifiers of misalignment and two on physical features, with one interface.

Training uses scikit-learn, XGBoost or PyTorch; classification needs only numpy.
"""
