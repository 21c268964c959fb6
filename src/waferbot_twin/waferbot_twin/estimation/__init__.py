# SPDX-License-Identifier: Apache-2.0
"""Sets of causes, and their values with intervals: one estimator for diagnosis and identification."""
