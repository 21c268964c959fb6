# SPDX-License-Identifier: Apache-2.0
"""The twin as a whole: run, record, replay, compare, plot."""
