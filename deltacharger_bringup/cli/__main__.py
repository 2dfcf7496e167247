# SPDX-License-Identifier: Apache-2.0
"""Run the command from the sources: python -m deltacharger_bringup.cli."""

import sys

from deltacharger_bringup.cli.main import main

sys.exit(main())
