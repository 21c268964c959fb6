# SPDX-License-Identifier: Apache-2.0
"""Blind tests of the diagnosis: drawn, sized, run, compared with the truth, counted."""
