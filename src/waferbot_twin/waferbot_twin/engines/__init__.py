# SPDX-License-Identifier: Apache-2.0
"""Ways to run the same model: in one process without ROS, composed, or as separate ROS 2 nodes."""
