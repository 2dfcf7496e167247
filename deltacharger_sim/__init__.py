# SPDX-License-Identifier: Apache-2.0
"""The world behind the emulated hardware: mechanics, contact, magnets and the charging circuit."""
