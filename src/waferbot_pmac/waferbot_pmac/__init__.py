# SPDX-License-Identifier: Apache-2.0
"""The Turbo PMAC: servo law, I-variables, trajectories and experiments, free of ROS."""
