# SPDX-License-Identifier: Apache-2.0
"""A second contact physics, by which estimators are judged; nothing is ever trained, fitted or chosen on it.

It is imported only where it is asked for.
"""
