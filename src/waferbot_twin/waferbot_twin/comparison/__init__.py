# SPDX-License-Identifier: Apache-2.0
"""
Measured beside simulated, signal by signal.

`blocks` replays each block of a model on a measured log, `pairs` lays two logs over one another and
runs the closed loop that a log was made with, `overlay` keeps the result as a recording with a picture.
"""
