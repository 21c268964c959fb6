# SPDX-License-Identifier: Apache-2.0
"""Controllers of ros2_control close the loop on the twin's plant, in place of the PMAC."""
