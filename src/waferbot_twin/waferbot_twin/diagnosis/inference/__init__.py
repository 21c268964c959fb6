# SPDX-License-Identifier: Apache-2.0
"""Which causes, and how sure: one posterior over sets of causes."""
