# SPDX-License-Identifier: Apache-2.0
"""Measured logs, and what the blocks of a model leave over of them."""
