# SPDX-License-Identifier: Apache-2.0
"""A second contact physics for testing estimators; nothing may be trained, fitted or chosen with it.

Its solver and sheets are imported only when a campaign or report needs them.
"""
