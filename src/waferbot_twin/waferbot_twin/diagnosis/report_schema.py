# SPDX-License-Identifier: Apache-2.0
"""The version of `report.json`, for what writes it and for what reads it."""

SCHEMA = 3
"""It goes up when a program that reads the report has to change."""
