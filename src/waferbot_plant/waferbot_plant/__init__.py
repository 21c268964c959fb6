# SPDX-License-Identifier: Apache-2.0
"""The plant: mechanism, motors and encoders of the robot, as compiled functions over a description."""
