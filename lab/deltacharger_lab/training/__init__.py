# SPDX-License-Identifier: Apache-2.0
"""Training of the packaged models and of your own, and how their answers are judged."""
