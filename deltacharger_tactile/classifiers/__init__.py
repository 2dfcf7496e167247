# SPDX-License-Identifier: Apache-2.0
"""The paper's nine classifiers of misalignment and two on physical features, with one interface; only numpy."""
