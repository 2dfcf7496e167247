# SPDX-License-Identifier: Apache-2.0
"""What a charger says on its topics, kept in files."""
