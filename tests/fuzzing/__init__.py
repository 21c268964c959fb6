# SPDX-License-Identifier: Apache-2.0
"""Damaged input of every kind that comes from outside; see `categories`."""
