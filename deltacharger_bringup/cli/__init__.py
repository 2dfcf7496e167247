# SPDX-License-Identifier: Apache-2.0
"""The `deltacharger` command: one module per subcommand."""
