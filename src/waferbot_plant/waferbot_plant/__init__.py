# SPDX-License-Identifier: Apache-2.0
"""The plant: mechanism, motors and encoders, as compiled functions over a description."""
