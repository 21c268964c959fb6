# SPDX-License-Identifier: Apache-2.0
"""Diagnosis: what a measured log has that the simulation lacks, its cause, and what mending it gains."""
