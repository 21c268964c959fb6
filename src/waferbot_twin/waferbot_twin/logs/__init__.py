# SPDX-License-Identifier: Apache-2.0
"""
Measured logs: from whatever a machine wrote to signals in SI units, each at its own times.

`load.load_log` reads any log, `measured.MeasuredLog` is what comes of it, `archive` keeps one as a
recording that ROS tools open. What cannot be used is left out and reported (`findings`); nothing is
filled in.
"""
