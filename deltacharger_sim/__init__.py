# SPDX-License-Identifier: Apache-2.0
"""The simulated world behind the emulated hardware: mechanics, contact, magnets and the charging circuit."""
