# SPDX-License-Identifier: Apache-2.0
"""
Sweeps over parameters of a model: what a measure of a run does when they vary.

`variation` says what varies and where it is evaluated, `evaluation` runs one point, `sweep` all of
them, on all cores and to be resumed, `sensitivity` says how much of a measure each parameter explains,
`optimise` looks for the best point, `report` writes and draws.
"""
