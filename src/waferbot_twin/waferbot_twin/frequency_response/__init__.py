# SPDX-License-Identifier: Apache-2.0
"""Frequency responses from logs, measured beside simulated, and the peaks in which they differ."""
