# SPDX-License-Identifier: Apache-2.0
"""
A library of identified parameters by type of part: what was learnt of one machine, kept for the next.

`entries` reads and writes it, `from_report` takes entries out of an identification, `ranges` says
what is known of a parameter over machines and time.
"""
