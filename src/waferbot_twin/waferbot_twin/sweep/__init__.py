# SPDX-License-Identifier: Apache-2.0
"""
Sweeps over parameters of a model: what a measure of a run does when they vary.

`variation` says what varies and where it is evaluated, `evaluation` runs one point, `sweep` all of
them, on all cores and to be resumed, `sensitivity` says how much of a measure each parameter explains,
`report` writes and draws.

`optimise` looks for the best point within `limits`, `pareto` for the front of several measures (`nsga2`,
written and drawn by `front_report`); both run `populations` of points.
"""
