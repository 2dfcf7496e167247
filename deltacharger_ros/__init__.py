# SPDX-License-Identifier: Apache-2.0
"""What every node stands on: parameters, executor, quality of service, raw topics, the client."""
