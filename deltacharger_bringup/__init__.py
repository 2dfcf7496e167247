# SPDX-License-Identifier: Apache-2.0
"""What a person starts: scenes, the command `deltacharger`, the doctor, records of dockings."""
