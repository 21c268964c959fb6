# SPDX-License-Identifier: Apache-2.0
"""A recording in the browser: the machine moving, and its signals, served to this computer alone."""
