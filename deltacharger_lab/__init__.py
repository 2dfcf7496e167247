# SPDX-License-Identifier: Apache-2.0
"""What is measured: campaigns, reports and generated pages."""
