# SPDX-License-Identifier: Apache-2.0
"""The Copley Xenus MACRO amplifiers in current mode: the model, and its ROS 2 node."""
