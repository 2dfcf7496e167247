# SPDX-License-Identifier: Apache-2.0
"""A second contact physics, by which estimators are judged; nothing is ever trained, fitted or chosen on it.

Its solver and sheets are imported only where a campaign or report asks for them.
"""
